"""What sensors measure, by the names that records, settings and tables have for it."""

MOTION = ("displacement", "velocity", "acceleration")
GROUND, FORCE = "ground_acceleration", "force"
# Of a connection, the force within it.
CONNECTION_FORCE = "connection_force"
# Of a moving support, which is no DOF: what of the motion is measured.
SUPPORT = {f"support_{quantity}": quantity for quantity in MOTION}
# What acts on a structure.
INPUTS = (FORCE, GROUND, *SUPPORT)
UNITS = {**dict(zip(MOTION, ("m", "m/s", "m/s^2"), strict=True)), FORCE: "N", GROUND: "m/s^2", CONNECTION_FORCE: "N"}
UNITS |= {of_support: UNITS[quantity] for of_support, quantity in SUPPORT.items()}
# Of a sensor: what it shows of what it feels. The units of an offset and of a drift are over that of its quantity.
CALIBRATION_UNITS = {"gain": "", "offset": "", "drift": "/s", "delay": "s", "tilt": "1/s^2", "high_pass": "Hz"}
TILT, HIGH_PASS = "tilt", "high_pass"
# Those that depend on what a record holds and when it begins; the others are the sensor's own.
OF_ONE_CHANNEL = ("offset", "drift")
# What a motion that goes on from an earlier record's end begins with; uncertain, as parameters are.
INITIAL_STATE = "initial_state"
# Uncertain numbers that stand in no equation of motion.
OUTSIDE_THE_EQUATIONS = (*CALIBRATION_UNITS, INITIAL_STATE)
