"""The real-time loop: phases, safety checks, commands, absolute deadlines and the link to DDS."""
