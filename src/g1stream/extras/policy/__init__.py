"""Learned policies: inputs and outputs, streaming, and analysis of their steps."""
