"""Writers of one process take turns in order of arrival; people go before jobs."""

import threading
from contextlib import ExitStack, closing, contextmanager

import pytest
from sqlalchemy import text
from sqlalchemy.exc import TimeoutError as WaitedTooLong

from app.db.engine import Database
from app.db.turns import PEOPLE_IN_A_ROW, Turns
from tests.support.databases import empty_postgres
from tests.support.waiting import until

SOON_S = 10


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request, tmp_path):
    """A new database for each test, of each kind."""
    with ExitStack() as opened:
        url = f"sqlite:///{tmp_path}/some.db"
        if request.param == "postgresql":
            url = opened.enter_context(empty_postgres())
        yield opened.enter_context(closing(Database(url)))


@contextmanager
def hold_turn(database):
    """Hold the turn to write while the test lets other writers wait for it.

    Yields a function that starts a writer and waits until it is queued, and a list
    that has the names of the writers in the order of their turns.
    """
    order, threads = [], []

    def write(name, person):
        with database.write(person=person) as session:
            session.execute(text("SELECT 1"))
            order.append(name)

    def ask(name, *, person=False):
        thread = threading.Thread(target=write, args=(name, person))
        before = database.turns.waiting
        thread.start()
        threads.append(thread)
        until(lambda: database.turns.waiting == before + 1)

    with database.write() as first:
        first.execute(text("SELECT 1"))
        yield ask, order
    for thread in threads:
        thread.join(SOON_S)
        assert not thread.is_alive()


def test_writers_take_turns_in_order_of_arrival(database):
    with hold_turn(database) as (ask, order):
        for name in range(8):
            ask(name)

    assert order == list(range(8))


def test_people_write_before_jobs_but_jobs_still_get_turns(database):
    with hold_turn(database) as (ask, order):
        for name in ("work 1", "work 2"):
            ask(name)
        people = list(range(2 * PEOPLE_IN_A_ROW + 1))
        for number in people:
            ask(number, person=True)

    first, second = people[:PEOPLE_IN_A_ROW], people[PEOPLE_IN_A_ROW:-1]
    assert order == [*first, "work 1", *second, "work 2", people[-1]]


def test_writer_that_fails_releases_its_turn(database):
    with hold_turn(database) as (ask, order):
        ask("next")
        failing = pytest.raises(ZeroDivisionError)

    with failing, database.write() as session:
        session.execute(text("SELECT 1"))
        raise ZeroDivisionError

    with database.write() as session:
        session.execute(text("SELECT 1"))
    assert order == ["next"]


def test_lost_connection_releases_the_turn(database):
    with database.write() as session:
        session.connection().invalidate()
        session.rollback()

    with database.write() as session:
        assert session.execute(text("SELECT 1")).scalar_one() == 1


def test_a_writer_that_waited_too_long_leaves_the_queue():
    turns = Turns()
    turns.take(person=True, wait_s=0)

    with pytest.raises(WaitedTooLong, match=r"writing for 0\.01 seconds"):
        turns.take(person=False, wait_s=0.01)

    assert turns.waiting == 0
    turns.give_back()
    turns.take(person=False, wait_s=0)
