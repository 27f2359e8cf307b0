"""Help pages: arguments as other programs show them, `RECIPE`; typer's own are `{RECIPE}` and `RECIPE <path>`."""

from __future__ import annotations

from typing import Any

import typer


class _Argument(typer.core.TyperArgument):
    """An argument, shown by its name alone."""

    def get_usage_pieces(self, ctx: Any) -> list[str]:
        name = self._shown
        return [name if self.required else f"[{name}]"]

    def get_help_record(self, ctx: Any) -> tuple[str, str] | None:
        record = super().get_help_record(ctx)
        return None if record is None else (self._shown, record[1])

    @property
    def _shown(self) -> str:
        return self.metavar or str(self.name).upper()


def show_plainly(command: Any) -> None:
    """Show the arguments of a command, or of a group's commands, by their names alone."""
    for parameter in command.params:
        if isinstance(parameter, typer.core.TyperArgument):
            parameter.__class__ = _Argument  # typer makes the arguments, and has no place to name another class
    for one in getattr(command, "commands", {}).values():
        show_plainly(one)
