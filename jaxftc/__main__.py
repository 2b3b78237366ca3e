"""``python -m jaxftc``: the command ``jaxftc``."""

from jaxftc.cli.main import main

main()
