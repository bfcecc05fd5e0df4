"""Messages and layouts for viewers: transforms, joint states, scenes and tracking errors."""
