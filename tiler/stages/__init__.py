"""What a run does, stage by stage: which tasks there are, which are done, and what they found together."""
