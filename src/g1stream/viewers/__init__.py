"""What viewers show: layouts, and pictures of the robot."""
