"""The application: what it imports."""

import subprocess
import sys


def test_the_application_imports_no_scipy_or_kiss_icp_until_something_needs_them() -> None:
    # They take 45 MB and 0.3 s, and answers do without: import them where they are used.
    program = "import app.main, sys; sys.exit(bool({'scipy', 'kiss_icp'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
