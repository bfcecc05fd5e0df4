"""ROS 2: bags as motions, sessions as bags, and topics for RViz."""
