"""Rests of gyros alone, as a table."""

from __future__ import annotations

from tumble.run.gyros_alone import MORE, GyroRests
from tumble.units import DEGREE
from tumble.views.blocks import Block, table


def gyro_blocks(found: GyroRests) -> list[Block]:
    """Rests with their means, and by how much the device was turned after each."""
    rows = []
    for i, rest in enumerate(found.segmentation.rests):
        means = {f"{axis} °/s": f"{value / DEGREE:z.4f}" for axis, value in zip("xyz", found.mean[i], strict=True)}
        turned = f"{found.turned[i] / DEGREE:.0f}" if i < len(found.turned) else ""
        times = {"rest": str(i + 1), "from s": f"{rest.start:z.1f}", "to s": f"{rest.stop:z.1f}"}
        rows.append(times | means | {"then turned by °": turned})
    unknown = "" if found.session.log.accel.scale_stated else "; their unit is not known: state --gyro-unit, for the "
    return [
        "gyros alone: the rests are those by their level" + (f"{unknown}numbers are no °/s" if unknown else ""),
        table(rows),
        f"for biases: tumble calibrate; for noise: tumble noise; for scale factors and axes {MORE}",
    ]
