"""The MuJoCo bridge: a simulated G1 on the topics of the real one."""
