"""A server that tests end in several ways and start again over the same data folder."""

from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

from alembic.config import Config
from alembic.script import ScriptDirectory

from app.db.engine import make_engine
from app.db.migrate import WouldLose, current_revision, head_revision, migrate
from app.package import migrations_dir
from tests.support.api import Api
from tests.support.databases import url_of
from tests.support.servers import RunningServer, running_server

SETTINGS: Final = {
    "UNGHOST_WORKERS": "2",
    "UNGHOST_LOG_LEVEL": "warning",
    "UNGHOST_MAX_OPEN_RUNS": "10000",
}
WAYS_TO_RESTART: Final = ("terminated", "killed", "migrated down and up")


class Restarting:
    """A running server that can be restarted."""

    server: RunningServer
    api: Api

    def __init__(self, data: Path) -> None:
        self._data = data
        self._open = ExitStack()
        self.restarts = 0
        self._begin()

    def _begin(self) -> None:
        self.server = self._open.enter_context(running_server(self._data, SETTINGS))
        self.api = Api.at(self.server.url, self.server.headers)
        self._open.enter_context(self.api.http)

    def restart(self, way: str) -> None:
        """End the server in one of `WAYS_TO_RESTART`; start one on the same folder."""
        if way != "terminated":
            self.server.process.kill()
            self.server.process.wait()
        self.close()
        if way == "migrated down and up":
            self._go_down_and_up()
        self._open = ExitStack()
        self._begin()
        self.restarts += 1

    def close(self) -> None:
        self._open.close()

    def _go_down_and_up(self) -> None:
        engine = make_engine(url_of(self._data))
        try:
            with suppress(WouldLose):  # then nothing has changed
                migrate(engine, migrations_dir(), _before_head())
                assert current_revision(engine) == _before_head()
            migrate(engine, migrations_dir())
            assert current_revision(engine) == head_revision(migrations_dir())
        finally:
            engine.dispose()


def _before_head() -> str:
    config = Config()
    config.set_main_option("script_location", str(migrations_dir()))
    scripts = ScriptDirectory.from_config(config)
    head = scripts.get_revision("head")
    assert head is not None
    assert isinstance(head.down_revision, str)
    return head.down_revision
