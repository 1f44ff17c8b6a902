"""History: how loss and errors fell while a fit ran."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.input_files import TEXT_BYTES, read_text
from pbrfit.values.quoting import shown


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
WITHOUT_TRUTH = COLUMNS[:5]

MOST = 1e300
"""Numbers beyond are not those of a fit; a float holds these."""


@dataclass(frozen=True)
class History:
    """Rows of `history.csv`; `history["loss"]` is a column."""

    rows: tuple[HistoryRow, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns: the errors against ground truth only where there is one."""
        known = any(not math.isnan(row.albedo_rmse) for row in self.rows)
        return COLUMNS if known else WITHOUT_TRUTH

    @property
    def iterations(self) -> int:
        """That were done."""
        return self.rows[-1].iteration

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
        """Read what `save` wrote.

        Raises InputError if the file has other columns, no rows, or an entry that is not a number;
        OSError if it cannot be read.
        """
        try:
            header, *lines = csv.reader(io.StringIO(read_text(path, TEXT_BYTES), newline=""))
            if tuple(header) not in (COLUMNS, WITHOUT_TRUTH):
                raise ValueError(f"columns {', '.join(header)}")
            rows = tuple(
                HistoryRow(**{k: _number(k, v) for k, v in zip(header, line, strict=True)})
                for line in lines
            )
            if not rows:
                raise ValueError("no rows")
        except InputError:
            raise
        except (ValueError, csv.Error) as error:
            raise InputError(
                f"{path}: expected columns {', '.join(WITHOUT_TRUTH)} of numbers, "
                f"found: {shown(error)}"
            ) from None
        return cls(rows)


def _number(column: str, entry: str) -> Any:
    """Of a column; ValueError if it is none. Errors may be NaN, which stands for unknown."""
    value = int(entry) if column in ("iteration", "evaluations") else float(entry)
    if abs(value) <= MOST or (value != value and column not in WITHOUT_TRUTH):
        return value
    raise ValueError(f"{entry} under {column}")
