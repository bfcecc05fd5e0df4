"""Recording of DDS topics into a session file."""
