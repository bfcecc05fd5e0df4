"""The MuJoCo bridge: a simulated G1 on the DDS topics of the robot."""
