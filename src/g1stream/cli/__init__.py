"""The command line: parses, wires, prints and picks the exit code; nothing else."""
