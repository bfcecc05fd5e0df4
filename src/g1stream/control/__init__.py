"""The real-time loop: phases and safety (pure), absolute deadlines, and what ties them to DDS."""
