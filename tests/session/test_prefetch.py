"""Work done ahead of where its results are needed."""

import pytest

from g1stream.session.prefetch import ahead


def test_work_ahead_keeps_order_and_takes_no_more_than_it_needs():
    taken = []

    def items():
        for i in range(1000):
            taken.append(i)
            yield i

    results = ahead(lambda i: i * i, items())
    assert [next(results) for _ in range(5)] == [0, 1, 4, 9, 16]
    assert len(taken) < 30
    assert list(results) == [i * i for i in range(5, 1000)]


def test_what_fails_ahead_is_raised_where_it_belongs():
    def work(i):
        if i == 3:
            raise KeyError(i)
        return i

    results = ahead(work, range(10))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(KeyError):
        next(results)
