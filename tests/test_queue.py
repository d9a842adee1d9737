"""The hand-over loses nothing silently: what was pushed is popped in order, or counted where it was lost."""

from __future__ import annotations

import threading
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.telemetry import DropOldestQueue, Sample

POP = None  # an operation: pop, where an integer is the payload size of a push


def sample(number: int, size: int = 1) -> Sample:
    return Sample("state", number, b"x" * size)


def drain(queue: DropOldestQueue) -> list[tuple[int, int]]:
    popped = []
    while (item := queue.pop()) is not None:
        popped.append((item[0], item[1].t_ns))
    return popped


def test_samples_come_out_in_the_order_they_went_in() -> None:
    queue = DropOldestQueue(10, 1000)
    for number in range(10):
        queue.push(sample(number))
    assert drain(queue) == [(0, number) for number in range(10)]
    assert queue.pop() is None
    assert queue.dropped == 0


def test_the_oldest_give_way_and_the_gap_shows_where_they_were() -> None:
    queue = DropOldestQueue(3, 1000)
    queue.push(sample(0))
    assert drain(queue) == [(0, 0)]
    for number in range(1, 8):
        queue.push(sample(number))
    assert drain(queue) == [(4, 5), (0, 6), (0, 7)]
    assert queue.dropped == 4


def test_the_bound_in_bytes_holds_and_an_oversized_payload_is_dropped_itself() -> None:
    queue = DropOldestQueue(100, 10)
    for number in range(3):
        queue.push(sample(number, size=4))
    assert queue.payload_bytes == 8
    queue.push(sample(3, size=11))
    assert len(queue) == 0
    assert queue.dropped == 4
    assert queue.lost_at_end() == 4
    assert queue.lost_at_end() == 0
    queue.push(sample(4, size=10))
    assert drain(queue) == [(0, 4)]


@pytest.mark.parametrize(("capacity", "capacity_bytes"), [(0, 1), (1, 0), (-1, 1)])
def test_a_queue_without_room_is_refused(capacity: int, capacity_bytes: int) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        DropOldestQueue(capacity, capacity_bytes)


@given(
    capacity=st.integers(1, 6),
    capacity_bytes=st.integers(1, 30),
    operations=st.lists(st.one_of(st.just(POP), st.integers(0, 12)), max_size=60),
)
def test_it_behaves_as_its_model(capacity: int, capacity_bytes: int, operations: list[int | None]) -> None:
    queue = DropOldestQueue(capacity, capacity_bytes)
    model: deque[tuple[int, int]] = deque()  # number, size
    dropped = lost = pushed = 0
    for operation in operations:
        if operation is POP:
            item = queue.pop()
            if not model:
                assert item is None
                continue
            assert item is not None
            assert (item[0], item[1].t_ns) == (lost, model.popleft()[0])
            lost = 0
        else:
            pushed += 1
            queue.push(sample(pushed, operation))
            model.append((pushed, operation))
            while len(model) > capacity or sum(size for _, size in model) > capacity_bytes:
                model.popleft()
                dropped += 1
                lost += 1
        assert len(queue) == len(model)
        assert queue.payload_bytes == sum(size for _, size in model)
        assert queue.dropped == dropped
    if not model:
        assert queue.lost_at_end() == lost


def test_two_threads_account_for_every_sample() -> None:
    queue = DropOldestQueue(50, 10_000)
    total = 30_000
    done = threading.Event()

    def produce() -> None:
        for number in range(total):
            queue.push(sample(number))
        done.set()

    producer = threading.Thread(target=produce)
    producer.start()
    seen: list[tuple[int, int]] = []
    while not done.is_set():
        seen += drain(queue)
    producer.join()
    seen += drain(queue)
    expected = -1
    for lost, number in seen:
        expected += lost + 1
        assert number == expected
    assert len(seen) + queue.dropped == total
    assert len(seen) + sum(lost for lost, _ in seen) + queue.lost_at_end() == total
