"""`python -m poseaudit`: the binary, with the same arguments."""

import sys

from ._binary import exec_binary
from ._errors import ProgramError

if __name__ == "__main__":
    try:
        sys.exit(exec_binary(sys.argv[1:]))
    except ProgramError as error:
        sys.exit(f"error: {error}")
