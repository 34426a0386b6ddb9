"""The command line: ``python -m safewbc``, and the script ``safewbc``."""

import sys

from safewbc.installation import installation_problem

NOT_OURS = 2
"""Exit code where packages of others stand in the place of ours; as for an option that is not allowed."""


def main() -> None:
    """Check whose packages get imported, then run the command line."""
    if problem := installation_problem():
        print(f"safewbc: {problem}", file=sys.stderr)
        sys.exit(NOT_OURS)
    from experiments.cli.main import main as command_line

    command_line()


if __name__ == "__main__":
    main()
