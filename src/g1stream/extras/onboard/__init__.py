"""The robot's own controller: its motion service, and a simulation of both."""
