from known_sessions import change, motion, play, take, write_session

__all__ = ["change", "motion", "play", "take", "write_session"]
