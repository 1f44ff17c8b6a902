"""History: how loss and errors fell while a fit ran."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError


@dataclass(frozen=True)
class HistoryRow:
    """State after one iteration; row 0 is the start. Errors are NaN without ground truth.

    `loss` is what the solver minimises, in units of the scene scale squared; `recon_rmse` is in
    picture units. `elapsed_s` leaves out the time spent on comparing with ground truth.
    """

    elapsed_s: float
    iteration: int
    evaluations: int
    loss: float
    recon_rmse: float
    albedo_rmse: float = math.nan
    roughness_rmse: float = math.nan
    metallic_rmse: float = math.nan


COLUMNS = tuple(f.name for f in fields(HistoryRow))
TRUTH_COLUMNS = COLUMNS[5:]


@dataclass(frozen=True)
class History:
    """Rows of `history.csv`; `history["loss"]` is a column."""

    rows: tuple[HistoryRow, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns: the errors against ground truth only where there is one."""
        known = any(not math.isnan(row.albedo_rmse) for row in self.rows)
        return COLUMNS if known else COLUMNS[:5]

    def __getitem__(self, column: str) -> NDArray[np.float64]:
        return np.array([getattr(row, column) for row in self.rows], dtype=np.float64)

    def __len__(self) -> int:
        return len(self.rows)

    def save(self, path: Path) -> None:
        """Write CSV with a header line; numbers in full precision."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(self.columns)
            for row in self.rows:
                writer.writerow([repr(getattr(row, name)) for name in self.columns])

    @classmethod
    def load(cls, path: Path) -> History:
        """Read what `save` wrote."""
        integers = ("iteration", "evaluations")
        try:
            with path.open(newline="", encoding="utf-8") as file:
                return cls(
                    tuple(
                        HistoryRow(
                            **{k: int(v) if k in integers else float(v) for k, v in row.items()}  # type: ignore[arg-type]
                        )
                        for row in csv.DictReader(file)
                    )
                )
        except (TypeError, ValueError) as error:
            raise InputError(f"{path}: expected columns {COLUMNS[:5]}, found {error}") from None
