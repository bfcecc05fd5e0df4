"""MCAP files as bytes: written chunk by chunk, and read again whatever ended their writer."""
