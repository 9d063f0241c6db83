"""What helps to answer a question of `nlos new bench`: where the answer stands, and what it is good for."""

HINTS = {
    "mirror": "what turns the mirrors; `nlos devices` says what is plugged in",
    "port": "unplug it and see which one goes; names in /dev/serial/by-id (by-path without a serial number) stay",
    "volts_per_degree": "the galvo driver's manual, `input scale factor`: often 0.5 or 0.8; spots find it later",
    "max_mechanical_deg": "the head's data sheet; less is safer, moves beyond it are refused",
    "counter": "what times the photons; `nlos devices` says what is plugged in",
    "device": "the type plate",
    "sync_input": "counted as on the front, the first is 1",
    "detector_input": "counted as on the front, the first is 1",
    "sync_pulse": "the laser's manual, or an oscilloscope with 50 ohm: nim goes down, ttl goes up",
    "detector_pulse": "the detector's manual, or an oscilloscope with 50 ohm: nim goes down, ttl goes up",
    "markers": "with them every step of the mirror is counted, and a lost one is noticed",
    "pixel_clock": "with it the counter steps the mirror: faster than step by step from here",
    "shutter": "light is off unless this opens it; with none, somebody has to block the beam by hand",
    "shutter_pin": "the number beside the connector",
    "wall_distance_m": "a tape measure is good enough: spots and arrival times find it to a millimetre later",
    "mirror_separation_m": "the head's drawing: 0.005 to 0.015 for most pairs of galvos",
    "scanner_x_m": "seen by somebody who faces the wall",
    "scanner_y_m": "seen by somebody who faces the wall",
    "wall_yaw_deg": "seen from above; 0 for a wall straight ahead, or if not measured: spots find it",
    "wall_pitch_deg": "seen from the side; 0 for an upright wall, or if not measured: spots find it",
    "half_m": "nothing is sent beyond it: leave windows, screens and people outside",
    "half_height_m": "the same as to the sides for a square",
    "repetition_hz": "the laser's display or data sheet, such as 10e6; the doctor holds the sync signal against it",
}
"""Key of a question -> one line."""
