"""Makes the samples of a recording in several processes; they come in order, and are the same for any number.

Each worker has physics worlds of its own and makes whole tasks: a few blocks of the plan, drawn, exposed and encoded.
The noise of all images is one random stream. A task therefore carries where the stream stands, and a worker draws
its noise first and says where the stream stands then, so that the next task can begin elsewhere.
"""

from __future__ import annotations

import multiprocessing
import traceback
from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait

import cv2

from svmdist.errors import SimulationError, SvmdistError
from svmdist.recording.encode import EncodedSample, encode_all
from svmdist.simulation.bullet import require_pybullet
from svmdist.simulation.plan import Block, Plan
from svmdist.simulation.sensor import NoiseState
from svmdist.simulation.simulate import Simulator
from svmdist.workflows.parallel import one_opencv_thread
from svmdist.workflows.workers import END_S, Worker, begin_worker, close_inherited, end_workers, how_ended

Encoded = list[tuple[str, EncodedSample]]

FRAMES_PER_WORKER = 8
"""What a worker's start costs, 0.3 s, is what so many images take: below this, one worker less is faster."""
TASKS_AHEAD = 3
"""Tasks, for each worker, that may be at work or done while an earlier one is not: bounds the memory."""


class WorkerDiedError(SimulationError):
    """A worker ended without a word: it was killed."""


@dataclass(frozen=True)
class _Task:
    """Blocks to make, and where the random streams of the noise stand; None at their begin, and without noise."""

    number: int
    blocks: tuple[Block, ...]
    noise_states: tuple[NoiseState, ...] | None


@dataclass(frozen=True)
class _NoiseDrawn:
    """Where the random streams stand behind a task."""

    noise_states: tuple[NoiseState, ...]


@dataclass(frozen=True)
class _Done:
    """A task's samples."""

    number: int
    samples: Encoded


@dataclass(frozen=True)
class _Failed:
    """What went wrong in a worker."""

    error: Exception


def encoded_samples(
    plan: Plan, jobs: int, jpeg_quality: int | None = None
) -> Generator[tuple[str, EncodedSample]]:
    """Yield (topic, sample) of a plan in the order of time, made by `jobs` processes or fewer.

    Recordings of few images are made in this process, which is faster then. Raises WorkerDiedError where a process is
    killed, and what a worker raised. The workers end with the iterator.
    """
    require_pybullet()  # before there are workers, each of which would tell it
    workers = min(jobs, len(plan.blocks) // FRAMES_PER_WORKER)
    with one_opencv_thread():  # the cores are taken, and a forked process has no threads but its own
        if workers <= 1:
            with Simulator(plan) as simulator:
                for block in plan.blocks:
                    yield from encode_all(simulator.samples(block, simulator.draw_noise()), jpeg_quality)
            return
        with closing(_Pool(plan, workers, jpeg_quality)) as pool:
            for samples in pool.results():
                yield from samples


def _tasks(plan: Plan) -> list[tuple[Block, ...]]:
    """The blocks of each task: an even number of pictures, which spares the renderer a turn (see `DrawnWorld`)."""
    size = 1 if plan.extras.stereo else 2
    blocks = plan.blocks
    return [tuple(blocks[begin : begin + size]) for begin in range(0, len(blocks), size)]


class _Pool:
    """Processes that work through a plan's tasks; `close` ends them."""

    def __init__(self, plan: Plan, count: int, jpeg_quality: int | None, method: str | None = None) -> None:
        self._tasks = _tasks(plan)
        self._workers: list[Worker[int]] = []
        self._noise_states: tuple[NoiseState, ...] | None = None
        self._has_noise = plan.noise > 0.0
        # A fork costs 10 ms, a new interpreter with all imports 0.5 s. Nothing that minds a fork is alive here:
        # physics worlds and OpenCV's threads are not, and the workers make their own.
        forks = "fork" in multiprocessing.get_all_start_methods()
        context = multiprocessing.get_context(method or ("fork" if forks else "spawn"))
        try:
            for _ in range(count):
                arguments = (plan, jpeg_quality)
                self._workers.append(begin_worker(context, _work, arguments, self._workers, daemon=True))
        except BaseException:
            self.close()
            raise

    def results(self) -> Iterator[Encoded]:
        """Yield the samples of each task in order."""
        done: dict[int, Encoded] = {}
        given = 0
        may_give = True  # not while the noise before the next task is still being drawn
        for wanted in range(len(self._tasks)):
            while wanted not in done:
                for worker in self._workers:
                    ahead = given - wanted < TASKS_AHEAD * len(self._workers)
                    if worker.task is None and may_give and ahead and given < len(self._tasks):
                        self._give(worker, given)
                        given += 1
                        may_give = not self._has_noise
                for worker, message in self._messages():
                    match message:
                        case _NoiseDrawn():
                            if self._has_noise:
                                self._noise_states, may_give = message.noise_states, True
                        case _Done():
                            done[message.number], worker.task = message.samples, None
                        case _Failed():
                            raise message.error
            yield done.pop(wanted)

    def _give(self, worker: Worker[int], number: int) -> None:
        worker.task = number
        try:
            worker.connection.send(_Task(number, self._tasks[number], self._noise_states))
        except OSError:
            raise _last_words(worker) or _died(worker) from None

    def _messages(self) -> Iterator[tuple[Worker[int], object]]:
        """Wait for workers, and give what they say."""
        by_connection = {worker.connection: worker for worker in self._workers}
        for connection in wait(list(by_connection)):
            worker = by_connection[connection]  # type: ignore[index]
            try:
                message = worker.connection.recv()
            except (EOFError, OSError):
                raise _died(worker) from None
            yield worker, message

    def close(self) -> None:
        """End all workers, whatever they are doing."""
        end_workers(self._workers)
        self._workers.clear()


def _last_words(worker: Worker[int]) -> Exception | None:
    """What a worker that is no longer there said went wrong; None where it said nothing."""
    with suppress(EOFError, OSError):
        while worker.connection.poll():
            message = worker.connection.recv()
            if isinstance(message, _Failed):
                return message.error
    return None


def _died(worker: Worker[int]) -> WorkerDiedError:
    worker.process.join(END_S)
    how = how_ended(worker.process.exitcode)
    return WorkerDiedError(f"a process that draws images {how}, perhaps for want of memory: try fewer --jobs")


def _work(connection: Connection, inherited: list[Connection], plan: Plan, jpeg_quality: int | None) -> None:
    """Do tasks until there is nobody to give them."""
    close_inherited(inherited)
    cv2.setNumThreads(1)
    with suppress(EOFError, OSError):  # nobody is there any more
        try:
            with Simulator(plan) as simulator:
                while True:
                    _do(connection, simulator, connection.recv(), jpeg_quality)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return
        except Exception as error:
            if not isinstance(error, SvmdistError):
                error.add_note("".join(traceback.format_exception(error)))
            connection.send(_Failed(error))


def _do(connection: Connection, simulator: Simulator, task: _Task, jpeg_quality: int | None) -> None:
    if task.noise_states is not None:
        simulator.noise_states = task.noise_states
    noises = [simulator.draw_noise() for _ in task.blocks]
    connection.send(_NoiseDrawn(simulator.noise_states))
    samples: Encoded = []
    for block, noise in zip(task.blocks, noises, strict=True):
        samples += encode_all(simulator.samples(block, noise), jpeg_quality)
    connection.send(_Done(task.number, samples))
