"""A robot on its own feet: plans, balance, torques."""
