"""What a user runs: stream, replay, record, sim, convert, live, demo and rollout."""
