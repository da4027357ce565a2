"""`auto`, the default: decides the source of the cloud and filters LiDAR and photogrammetric clouds differently."""
