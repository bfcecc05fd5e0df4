"""Robot model of the G1: joints, limits, links, kinematics and dynamics; without clocks or DDS."""
