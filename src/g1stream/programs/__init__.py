"""The programs: each wires the rooms together into something that runs."""
