"""``python -m aerotube`` is the command ``aerotube``."""

from aerotube.cli import app

app()
