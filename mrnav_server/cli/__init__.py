"""The mrnav command."""
