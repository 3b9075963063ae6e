"""`trimtab completion`: shell completion of subcommands, options, scenarios and setting paths."""

import click
from click.shell_completion import get_completion_class

SHELLS = ("bash", "zsh", "fish")
VARIABLE = "_TRIMTAB_COMPLETE"


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
def command(shell: str) -> None:
    """Print the script that lets your shell complete trimtab.

    The script completes subcommands, options, scenarios and paths of settings.

    \b
    trimtab completion bash >> ~/.bashrc
    trimtab completion zsh >> ~/.zshrc
    trimtab completion fish > ~/.config/fish/completions/trimtab.fish
    """
    found = get_completion_class(shell)
    assert found is not None, shell
    click.echo(found(click.get_current_context().find_root().command, {}, "trimtab", VARIABLE).source())
