# `make demo` and `make test` set up everything they need on a fresh machine; once that is there they start at once.

VENV   := .venv
BIN    := $(VENV)/bin
PYTHON := $(firstword $(shell for p in python3.14 python3.13 python3.12 python3.11 python3 python; do \
            $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p; done))
READY  := $(VENV)/.ready

.PHONY: demo test lint bench setup libusb chromium clean

demo: setup
	$(BIN)/uwgraph demo -o demo-output

# One process per core; one thread in each, or they would stand in each other's way.
test: lint chromium
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n auto --dist loadfile

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Figures of benchmarks/: those on simulated dives, then those on recordings where they are there.
DATA  ?= $(or $(UWGRAPH_DATA),../shared/data)
BENCH := OMP_NUM_THREADS=1 $(BIN)/python benchmarks

bench: setup
	$(BENCH)/speed.py
	$(BENCH)/lowering.py
	$(BENCH)/consistency.py
	$(BENCH)/calibration.py
	$(BENCH)/import_memory.py --gigabytes 0.5 --case mixed
	$(BENCH)/sun_value.py --simulated
	$(BENCH)/sun_speed.py
	$(BENCH)/efficiency.py
	$(BENCH)/gradient.py
	$(BENCH)/polarization.py
	$(BENCH)/sun_depth.py
	$(BENCH)/geolocation.py
	$(BENCH)/lmnn.py
	$(BENCH)/closures.py --seeds 4
	$(BENCH)/filter_speed.py
	$(BENCH)/noise_step.py --runs 10
	$(BENCH)/filter_or_smoother.py --seeds 4
	test ! -d $(DATA)/seafloor_photos || $(BENCH)/seafloor_map.py --photos $(DATA)/seafloor_photos
	test ! -d $(DATA)/subvo || $(BENCH)/retrieval.py --frames $(DATA)/subvo
	test ! -d $(DATA)/subvo || $(BENCH)/visual_odometry.py --pool $(DATA)/subvo
	@test -d $(DATA) || echo "no recordings in $(DATA): name their folder with DATA=..."
	test ! -d $(DATA)/snapir || $(BENCH)/snapir.py $(DATA)/snapir
	test ! -d $(DATA)/snapir || $(BENCH)/filters_snapir.py $(DATA)/snapir
	test ! -d $(DATA)/snapir || $(BENCH)/calibration_snapir.py $(DATA)/snapir
	test ! -d $(DATA)/snapir || $(BENCH)/sun_value.py $(DATA)/snapir
	test ! -d $(DATA)/snapir || $(BENCH)/sun_images.py $(DATA)/snapir
	test ! -d $(DATA)/sky_images || $(BENCH)/sky_images.py $(DATA)/sky_images
	test ! -d $(DATA)/sky_compass || $(BENCH)/sky_compass.py $(DATA)/sky_compass
	test ! -d $(DATA)/euroc || $(BENCH)/euroc.py $(DATA)/euroc

setup: $(READY)

$(READY): pyproject.toml
	@test -n "$(PYTHON)" || { echo "uwgraph needs Python 3.11 or newer, and there is none on PATH" >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@$(MAKE) --no-print-directory libusb
	@touch $@

# open3d loads the system's libusb-1.0 when it is imported, and its wheel does not bring it.
HAS_LIBUSB := $(BIN)/python -c 'import ctypes.util, sys; sys.exit(not ctypes.util.find_library("usb-1.0"))'

libusb:
	@if $(HAS_LIBUSB); then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq libusb-1.0-0 >/dev/null; \
	else \
	    echo "note: maps need the system library libusb-1.0 (Debian, Ubuntu: apt install libusb-1.0-0;" >&2; \
	    echo "      Fedora: dnf install libusb1; macOS: brew install libusb); all else works without it" >&2; \
	fi

# The tests of the report look at it in a browser; without one they skip, and say so.
chromium:
	@if command -v chromedriver >/dev/null && command -v chromium >/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq chromium chromium-driver >/dev/null; } \
	    || echo "note: chromium could not be installed; the tests of the report in a browser will be skipped" >&2; \
	else \
	    echo "note: tests of the report in a browser need chromium and chromedriver (Debian: apt install chromium chromium-driver)" >&2; \
	fi

clean:
	rm -rf $(VENV) demo-output build dist
