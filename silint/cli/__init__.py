"""The command line: demo, bake, prt, bench, info; one module for each.

Only typer is imported before a command runs, so that help and mistakes answer at once.
"""

from __future__ import annotations

from silint.cli.app import app, main, run

__all__ = ["app", "main", "run"]
