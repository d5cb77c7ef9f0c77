"""The application: what it imports."""

import subprocess
import sys


def test_the_application_imports_no_scipy_until_something_needs_it() -> None:
    # It takes 45 MB and 0.3 s, and answers do without: import it where it is used.
    program = "import app.main, sys; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
