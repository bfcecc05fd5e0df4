"""What runs: stream, replay, record, sim, convert, live, demo, rollout, doctor."""
