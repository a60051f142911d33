"""Policy, planning and the law that makes the robot follow."""
