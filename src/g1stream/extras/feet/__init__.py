"""Balance control of a robot on its own feet: motion changes, balance, torques."""
