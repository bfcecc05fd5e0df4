"""What viewers show: layouts, Rerun, and pictures of the robot."""
