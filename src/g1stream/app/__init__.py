"""What a user runs: stream, record, sim, convert, live, demo and rollout."""
