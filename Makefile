# make run     the daemon against a virtual board, live; Ctrl-C ends it
# make test    everything, on a clean machine too: installs what the tests need
# make quick   the tests of edge/ and the protocol that take no seconds each (a minute and a half)
# make lint    ruff and mypy
# make docs    the manual, out/manual/index.html; every link and the generated reference are checked
# make bench   the tables of the manual (up to an hour)
# make model   edge/models/default_arx.json anew, from 15 runs of the virtual board
# make firmware  the boards' programs anew, firmware_protocol/hex (avr-gcc)
# make board-programs  every scenario, and two hours, on the boards' programs in simavr (an hour)
# make walk-through  from an empty board in simavr to commissioned control, each step a command of the manual (hours)
# make deb     Debian packages for amd64 and arm64, out/deb
# make deb-test  installs, upgrades, breaks and removes them in a Debian of their own (root, half an hour and more)
# make boot-test  boots an arm64 machine in qemu and tries the package on it: power cuts, watchdog, an hour (root, hours)
# make boot-fleet  boots a fresh Debian 12 and tries the manual of a fleet on it: kills, a power cut, the end (root, hours;
#              ARGS=--container: a quarter of an hour)
# make home-assistant-test  a real Home Assistant from PyPI with a rig: every entity and order (root)
# make train   every model anew from the recorded runs, compared, and the default bundle (half an hour)

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: run test quick lint docs bench model train firmware board-programs walk-through deb deb-test boot-test boot-fleet home-assistant-test tools clean

run: $(VENV)/edge.installed
	$(BIN)/greenhouse demo $(ARGS)

test: $(VENV)/dev.installed tools
	$(BIN)/python -m pytest -n 4 --dist loadfile --no-loadscope-reorder $(ARGS)

quick: $(VENV)/dev.installed
	$(BIN)/python -m pytest -n 3 --dist loadfile -m "not slow" tests/edge tests/firmware_protocol tests/test_*.py $(ARGS)

lint: $(VENV)/dev.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/docs.installed
	$(BIN)/python -m mkdocs build --strict $(ARGS)

bench: $(VENV)/dev.installed tools
	$(BIN)/python -m bench $(ARGS)

model: $(VENV)/edge.installed
	$(BIN)/python -m bench.make_default_arx $(ARGS)

train: $(VENV)/dev.installed
	$(BIN)/greenhouse-train all --out training/results/trained $(ARGS)
	$(BIN)/greenhouse-train evaluate && $(BIN)/greenhouse-train bundle 1.2 --out training/results/trained --default

firmware: tools
	sh firmware_protocol/c/build.sh $(CURDIR)/firmware_protocol/hex

board-programs: $(VENV)/dev.installed tools
	BOARD_PROGRAMS=all $(BIN)/python -m pytest -n 2 tests/hardware_in_the_loop/test_scenarios.py $(ARGS)

walk-through: $(VENV)/dev.installed tools
	PYTHONPATH=.:tests/firmware_protocol $(BIN)/python tests/hardware_in_the_loop/walk_through.py $(ARGS)

deb: $(VENV)/edge.installed
	sh deploy/deb/build.sh $(BIN)/python $(ARGS)

deb-test: $(VENV)/dev.installed
	sh tests/deploy/deb_all.sh $(BIN)/python

boot-test: $(VENV)/dev.installed tools
	sh deploy/deb/build.sh $(BIN)/python arm64
	PYTHONPATH=$(CURDIR) $(BIN)/python tests/deploy/boot_test.py out/deb/greenhouse_*_arm64.deb $(ARGS)

boot-fleet: $(VENV)/dev.installed
	PYTHONPATH=$(CURDIR) $(BIN)/python tests/deploy/boot_fleet.py $(ARGS)

home-assistant-test: $(VENV)/dev.installed tools
	PYTHONPATH=$(CURDIR) $(BIN)/python tests/real_home_assistant/run.py $(ARGS)

$(BIN)/pip:
	$(PYTHON) -m venv $(VENV)

$(VENV)/edge.installed: pyproject.toml | $(BIN)/pip
	$(BIN)/pip install --quiet --editable '.[page]'
	touch $@

$(VENV)/docs.installed: pyproject.toml | $(BIN)/pip
	$(BIN)/pip install --quiet --editable '.[docs]'
	touch $@

$(VENV)/%.installed: pyproject.toml training/pyproject.toml | $(BIN)/pip
	$(BIN)/pip install --quiet --editable '.[$*]' --editable './training[cluster]'
	touch $@

tools:
	sh tests/install_tools.sh

clean:
	rm -rf $(VENV) out build *.egg-info .mypy_cache .pytest_cache .ruff_cache
