"""`python -m silint.cli`: the same as `silint`."""

from __future__ import annotations

from silint.cli.app import main

main()
