"""What viewers get: transforms, joint states, scenes, tracking errors, layouts."""
