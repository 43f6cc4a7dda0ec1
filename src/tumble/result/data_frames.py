"""The parameters of a calibration as data frames, in SI."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tumble.errors import MissingExtraError

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

    from tumble.result.calibration import Calibration

_COLUMNS = ("name", "value", "u", "unit", "deviation", "run_to_run", "k", "dof", "prior", "learned")


def polars_frame(calibration: Calibration) -> pl.DataFrame:
    """The parameters, a row each."""
    import polars as pl

    schema = {name: pl.String if name in ("name", "unit") else pl.Float64 for name in _COLUMNS}
    return pl.DataFrame(_columns(calibration), schema=schema)


def pandas_frame(calibration: Calibration) -> pd.DataFrame:
    """The parameters, a row each. Raises MissingExtraError without pandas."""
    try:
        import pandas as pd
    except ModuleNotFoundError as error:
        said = "a pandas frame needs pandas; install it with: pip install pandas, or take to_polars()"
        raise MissingExtraError(said) from error
    return pd.DataFrame(_columns(calibration))


def _columns(calibration: Calibration) -> dict[str, list[Any]]:
    return {name: [getattr(parameter, name) for parameter in calibration.parameters] for name in _COLUMNS}
