"""`python -m poseaudit`: the binary, with the same arguments. The command `dataset` is Python."""

import sys

from ._binary import exec_binary
from ._errors import ProgramError

if __name__ == "__main__":
    try:
        if sys.argv[1:2] == ["dataset"]:
            from ._dataset_command import main

            sys.exit(main(sys.argv[2:]))
        sys.exit(exec_binary(sys.argv[1:]))
    except ProgramError as error:
        sys.exit(f"error: {error}")
