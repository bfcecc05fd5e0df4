"""What a user runs: stream, record, sim, convert, demo and rollout."""
