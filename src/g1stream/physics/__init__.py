"""The physics of a motion before it is played: what it would take of a robot, and what stands."""
