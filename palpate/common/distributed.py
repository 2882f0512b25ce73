"""Independent tasks on other machines, by the workers of a Dask scheduler (extra `distributed`).

Results are those of `palpate.common.workers.run_tasks`, whose processes run on this machine.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from palpate.common.workers import WorkerLost

Task = TypeVar("Task")
Result = TypeVar("Result")


def run_distributed(function: Callable[[Task], Result], tasks: Sequence[Task], scheduler: str) -> Iterator[Result]:
    """Yield results of all tasks, in the order in which they are done; leaving the loop early cancels the others.

    Args:
        function: importable by its name, here and by the workers.
        tasks: files that they name lie at the same path on all machines.
        scheduler: address of a scheduler whose workers have one thread each, such as tcp://host:8786.

    Raises:
        ValueError: Dask isn't installed, no scheduler answers, or it has no worker that can be used.
        WorkerLost: workers died of a task, most likely for want of memory.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ModuleNotFoundError as error:
        raise ValueError("--scheduler needs Dask; install 'palpate[distributed]'.") from error
    try:
        client = Client(scheduler, timeout=10, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ValueError(f"no Dask scheduler answers at {scheduler}; start one with `dask scheduler`.") from error
    with client:
        threads = client.nthreads().values()
        if set(threads) != {1}:
            found = f"workers of {max(threads)} threads" if threads else "no workers"
            raise ValueError(f"the scheduler {scheduler} has {found}; start them with `dask worker --nthreads 1`.")
        try:
            for future in as_completed(client.map(function, tasks, pure=False), loop=client.loop):
                yield future.result()
        except KilledWorker as error:
            raise WorkerLost("Workers were killed, maybe for want of memory; use fewer of them a machine.") from error
