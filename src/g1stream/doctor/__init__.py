"""What is wrong with the wire or this machine: facts are gathered first, then judged purely."""
