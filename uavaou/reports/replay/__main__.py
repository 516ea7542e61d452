"""Write pages anew around the missions that they hold, after a change of the page: ``FILE.html ...``."""

import sys
from pathlib import Path

from uavaou.files import write_text
from uavaou.reports.replay.page import fill_page, read_content

for place in map(Path, sys.argv[1:]):
    write_text(place, fill_page(read_content(place)))
