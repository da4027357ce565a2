"""`auto`, the default: decides what made the cloud, then filters laser scans and matched clouds in two ways."""
