"""What a run is: its record, who does its tasks, and what a worker does with one."""
