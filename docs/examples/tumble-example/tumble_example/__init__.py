"""What this package brings to tumble: here an export and a programme, which need no code."""

from pathlib import Path

SLOWFLY = Path(__file__).with_name("slowfly.tmpl")
"""The template of an export: `tumble export calibration.json --to slowfly -o imu.cfg`."""

SEESAW = [
    *("NUE", "NDW", "ENU", "WND", "UEN", "DWN"),  # X, Y, Z up and down
    *("NUE N+45", "ENU N+45", "UEN N+45", "NUE N-45", "ENU N-45", "UEN N-45"),
]
"""The positions of a programme in order, by their attitude codes: `tumble programme seesaw`."""
