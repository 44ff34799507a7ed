"""A builder in this process, next to the workspace that answers from its tables.

Importing this module gives each application that tests make such a workspace.
"""

from contextlib import ExitStack

from wrenchbook.service.http import app
from wrenchbook.service.tables.build import TableBuilder
from wrenchbook.service.tables.coordinator_state import FOLDER, CoordinatorState
from wrenchbook.service.workers.builder import building
from wrenchbook.service.workspace import Workspace


class BuildingWorkspace(Workspace):
    """A workspace with a builder on its own ledger and library, unless another has its folder."""

    builder: TableBuilder

    def start(self) -> None:
        self._parts = ExitStack()
        state = CoordinatorState(self.settings.data / FOLDER)
        if state.take():
            self._parts.callback(state.release)
            parts = self.ledger, self.library, self.errors
            self.builder = self._parts.enter_context(building(self.settings, parts, state))
        super().start()

    def stop_building(self) -> None:
        """Stop the builder, which writes what is not written yet; another may take its place."""
        self._parts.close()

    def close(self) -> None:
        self.stop_building()
        super().close()


app.Workspace = BuildingWorkspace
