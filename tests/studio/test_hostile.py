"""Some hundred malformed requests and messages: all are refused in a line each, and the studio goes on (5,000: scripts/bench/studio.py)."""

from __future__ import annotations

import logging

from tests.studio.hostile import attack
from tests.studio.serving import TOKEN, served, wool

import torchmat as tm
from torchmat.studio.serve import OneLine


def test_nothing_that_is_sent_ends_the_studio_or_leads_out_of_the_folder(tmp_path, caplog):
    folder = wool(tmp_path / "wool", 8)
    with served(folder) as studio, caplog.at_level(logging.WARNING, "torchmat.studio"):
        studio.get("/material.json")
        found = attack(studio.address, folder, 400)
        assert found["answers"] and found["sent"] >= 400
        assert sum(count for name, count in found.items() if name.startswith("outsider 403")) > 10
        lines = [OneLine().format(record) for record in caplog.records if record.levelno >= logging.WARNING]
        refused = sum(count for name, count in found.items() if name[-3:] in ("400", "403", "404", "405", "413", "431"))
        requests = found["sent"] - found["message"]  # how many of each kind depends on how soon the studio closes a line
        assert requests > 50 and refused > 0.7 * requests and len(lines) >= refused
        assert all("\n" not in line and len(line) <= 500 and TOKEN not in line for line in lines)
        assert not any(record.exc_info for record in caplog.records if record.name == "torchmat.studio")
        with studio.page() as page:
            assert page.hello["name"] == "wool"
        tm.load_material(folder)
