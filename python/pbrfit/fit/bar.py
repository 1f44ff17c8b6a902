"""How a fit is shown where Python runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pbrfit.fit.run import Progress


@contextmanager
def notebook_bar(iterations: int) -> Iterator[Callable[[Progress], None]]:
    """Give what moves a bar, in notebooks a widget: by iterations, of large pictures then tiles."""
    from tqdm.auto import tqdm

    with tqdm(total=iterations, unit="it", desc="fit") as bar:

        def show(progress: Progress) -> None:
            bar.set_postfix_str(f"recon {progress.recon_rmse:.2e}", refresh=False)
            done = progress.iteration
            if progress.tiles is not None:
                done, of = progress.tiles
                if done == 0:
                    bar.unit = "tile"
                    bar.reset(of)
            bar.update(done - bar.n)

        yield show
        bar.total = bar.n  # most fits need fewer iterations than they may do
        bar.refresh()
