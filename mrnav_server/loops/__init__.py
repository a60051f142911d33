"""What waits: tracking, hand link, control, recorder."""
