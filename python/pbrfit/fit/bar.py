"""How a fit is shown on a bar of `tqdm`'s kind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pbrfit.fit.run import Progress


@contextmanager
def shown_on(bar: Any) -> Iterator[Callable[[Progress], None]]:
    """Give what moves a bar of as many steps as a fit may take iterations; then it is complete.

    A large picture's lights take iterations; after that tiles are counted, which tell how much time
    is left.
    """

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
    # Most fits need fewer iterations than they may do: then the bar was all of them.
    bar.total = bar.n
    bar.refresh()


@contextmanager
def notebook_bar(iterations: int) -> Iterator[Callable[[Progress], None]]:
    """Show a fit where Python runs: a widget in a notebook, else a line on stderr."""
    from tqdm.auto import tqdm

    with tqdm(total=iterations, unit="it", desc="fit") as bar, shown_on(bar) as show:
        yield show
