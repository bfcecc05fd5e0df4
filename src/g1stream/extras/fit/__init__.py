"""The gap between robot and simulator: commands simulated again, and parameters fitted."""
