"""What most users do without: each folder is a pip extra of the same name."""
