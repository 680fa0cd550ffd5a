"""What sensors measure, by the names that records, settings and tables have for it."""

MOTION = ("displacement", "velocity", "acceleration")
GROUND, FORCE = "ground_acceleration", "force"
