"""Semi-autonomous navigation of magnetic micro-robots: the server, its training and its study tools."""

__version__ = "0.1.0"
