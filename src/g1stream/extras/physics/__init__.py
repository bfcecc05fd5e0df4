"""What a motion asks of a robot, and how it could stand in it, before it is played."""
