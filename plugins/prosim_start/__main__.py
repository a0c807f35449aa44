"""``python -m prosim_start`` is the ``prosim`` command."""

from . import main

main()
