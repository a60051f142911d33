"""Finding the robot in the image."""
