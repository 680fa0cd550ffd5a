"""What sensors measure, by the names that records, settings and tables have for it."""

MOTION = ("displacement", "velocity", "acceleration")
GROUND, FORCE = "ground_acceleration", "force"
# Of a connection, the force within it.
CONNECTION_FORCE = "connection_force"
UNITS = {**dict(zip(MOTION, ("m", "m/s", "m/s^2"), strict=True)), FORCE: "N", GROUND: "m/s^2", CONNECTION_FORCE: "N"}
# Of a sensor: what it shows of what it feels, the unit of each over that of the sensor's quantity.
CALIBRATION_UNITS = {"gain": "", "offset": "", "drift": "/s", "delay": "s"}
# What a motion that goes on from an earlier record's end begins with; uncertain, as parameters are.
INITIAL_STATE = "initial_state"
# Uncertain numbers that stand in no equation of motion.
OUTSIDE_THE_EQUATIONS = (*CALIBRATION_UNITS, INITIAL_STATE)
