"""Accelerometers with the opposite sign: Apple's CoreMotion reads −1 g on the axis that points up. Gyros carry the
vertical up or down alike, so that no recording shows it; the names do.

Source: Apple, CMAccelerometerData and CMMotionManager, Core Motion.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

_CORE_MOTION = re.compile(r"accelerometerAcceleration[XYZ]\(G\)")
_MAY_BE = re.compile(r"rotationRate\W?[xyzXYZ]")


def with_sign(content: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The content of a session with the sign of the accelerometers that their names tell, and what there is to say."""
    log = content["log"]
    accel = log["accel"]
    if accel["unit"] == "g" and all(_CORE_MOTION.fullmatch(name) for name in accel["columns"]):
        table = {"columns": accel["columns"], "unit": "count", "scale": -1.0, "scale_per": "g", "offset": 0.0}
        said = "accelerometers: as Apple's CoreMotion has them, −1 g where an axis points up: scale = -1 per g"
        return {**content, "log": {**log, "accel": table}}, [said]
    gyro = log.get("gyro", {"columns": ()})
    if any(_MAY_BE.search(name) for name in gyro["columns"]):
        return dict(content), [
            "accelerometers: beside gyros that are named as Apple's CoreMotion names them; it reads −1 g where an axis "
            'points up. If these do: unit = "count", scale = -1.0, scale_per their unit, offset = 0.0'
        ]
    return dict(content), []
