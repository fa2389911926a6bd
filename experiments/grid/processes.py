"""Worker processes of this machine, and schedulers that are there already, as clients of dask.distributed."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager

import jax
from dask import config
from distributed import Client, LocalCluster, Security
from distributed.comm.addressing import parse_address
from distributed.comm.core import connect

from slefejax.errors import InputError
from slefejax.experiments.grid.worker import OneCore

_HERE = "127.0.0.1"
_SETTINGS = {
    "distributed.admin.large-graph-warning-threshold": "10GB",  # scenes are large, and travel once a view
    "distributed.comm.timeouts.tcp": "30s",
}


@contextmanager
def on_this_machine(workers: int) -> Iterator[Client]:
    """So many processes, each on a core of its own while there are enough; they end with this one, however it ends."""
    folder = jax.config.values["jax_compilation_cache_dir"]
    env = {"LP_NUM_THREADS": "1"} | ({"JAX_COMPILATION_CACHE_DIR": folder} if folder else {})
    with config.set(_SETTINGS), ExitStack() as stack:
        with _unheard(signal.SIGINT):
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host=_HERE,
                dashboard_address=f"{_HERE}:0",
                scheduler_kwargs={"dashboard": False},
                memory_limit=0,  # of the machine's memory, the system says how much is too much
                silence_logs=logging.CRITICAL,
                env=env,
                plugins=(OneCore(sorted(os.sched_getaffinity(0))),),
            )
            stack.enter_context(cluster)
        yield stack.enter_context(Client(cluster))


@contextmanager
def scheduler_at(address: str, seconds: float) -> Iterator[Client]:
    """A client of the scheduler at an address. Raises InputError if it does not answer in time."""
    with config.set(_SETTINGS), ExitStack() as stack:
        try:
            with ThreadPoolExecutor(1) as apart:  # where no loop runs, as one does in a notebook
                apart.submit(asyncio.run, asyncio.wait_for(_answer(address, seconds), seconds + 0.5)).result()
            client = Client(address, timeout=seconds)
        except InputError:
            raise
        except Exception as error:  # whatever else may be listening there
            reason = str(error) or "it says nothing"
            raise InputError(f"no scheduler answers at {address} ({reason}): name it as tcp://HOST:8786") from None
        yield stack.enter_context(client)


async def _answer(address: str, seconds: float) -> None:
    """Ask who is there: a client that has begun to connect to something else does not give up."""
    own = Security().get_connection_args("client")
    if parse_address(address)[0] == "tls" and own.get("ssl_context") is None:
        raise InputError(f"{address} needs certificates: docs/studies.md says where they are looked for")
    comm = await connect(address, timeout=seconds, **own)
    try:
        await comm.write({"op": "identity", "n_workers": 0})
        await comm.read()
    finally:
        comm.abort()


@contextmanager
def _unheard(number: signal.Signals) -> Iterator[None]:
    """Threads and processes that start within never hear of a signal: Ctrl-C is for this one, which ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [number])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
