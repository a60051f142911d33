"""A client of the server in a few lines: send a hand, follow the twin, ask over REST (docs/client.md)."""
