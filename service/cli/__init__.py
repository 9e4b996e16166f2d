"""The command ``adverb`` with everything in it: the library's commands, and those of the service."""

from service.cli import keys
from service.cli.backup import backup_command, restore_command
from service.cli.doctor import doctor_command
from service.cli.load import PASS_ON, load_command
from service.cli.record import record_command
from service.cli.serve import serve_command, worker_command
from verbs import cli

__all__ = ["main"]

cli.app.command("serve")(serve_command)
cli.app.command("worker")(worker_command)
cli.app.command("doctor")(doctor_command)
cli.app.command("load", context_settings=PASS_ON, add_help_option=False)(load_command)
cli.app.command("record")(record_command)
cli.app.command("backup")(backup_command)
cli.app.command("restore")(restore_command)
cli.app.add_typer(keys.app, name="keys")


def main() -> None:
    """Run the command line."""
    cli.run(cli.app)
