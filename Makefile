# `make help` says what there is. Everything is built in the release profile: one build for the programs, their tests
# and the lints, and what is tested is what runs.
SHELL := /bin/bash
CARGO ?= cargo
export CARGO_TERM_COLOR ?= auto

TARGET := $(or $(CARGO_TARGET_DIR),target)
PICKCELL := $(TARGET)/release/pickcell
SCENES := ../shared/scenes

# Length of the long jobs; the short forms are for continuous integration.
SOAK_PAIRS ?= 100000
SOAK_PAIRS_30HZ ?= 20000
CAMPAIGN_RUNS ?= 10000
VM_ARGS ?=

.DEFAULT_GOAL := help
.PHONY: help needs build run test bench accuracy soak campaign vm deployed install uninstall fmt lint doc licences

help: ## say what there is
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 12

needs: ## install what the build needs and this machine lacks (apt; says what, asks nothing)
	@scripts/needs.sh

build: needs ## build pickcell and firmware-bridge
	$(CARGO) build --release --locked --workspace --bins

run: build ## run the cell of cell.toml: the recorded session and a simulated arm, until the session is over
	$(PICKCELL) run

test: needs ## every test; long ones in their short form (under 10 minutes on two cores)
	$(CARGO) test --release --locked --workspace

bench: needs ## the speed tables; OpenCV, scikit-image and skan beside them where python3 has them
	$(CARGO) bench --locked --workspace --bench '*'

accuracy: build ## the accuracy table: ../shared/scenes where they are, else the recorded session
	@if [ -d $(SCENES) ]; then $(PICKCELL) accuracy $(SCENES) --out out/accuracy; \
	else echo "accuracy: $(SCENES) is not here: only the recorded session" >&2; $(PICKCELL) accuracy replay; fi

soak: build ## endurance: SOAK_PAIRS as fast as possible, SOAK_PAIRS_30HZ at 30 a second
	$(PICKCELL) run --soak $(SOAK_PAIRS) --rate max
	$(PICKCELL) run --soak $(SOAK_PAIRS_30HZ) --rate 30

campaign: needs ## seeded fault campaigns against every link of the arm: CAMPAIGN_RUNS seeds
	CAMPAIGN_RUNS=$(CAMPAIGN_RUNS) $(CARGO) test --release --locked -p firmware-bridge --test arm campaign
	PICKCELL_CAMPAIGN_RUNS=$(CAMPAIGN_RUNS) $(CARGO) test --release --locked --test cell_campaign

vm: needs ## the cell in a virtual machine with V4L2 cameras (needs ../shared/v4l2-vm; VM_ARGS=--short)
	tests/vm/run.sh $(VM_ARGS)

deployed: needs ## make install, services, udev rule, a boot, make uninstall on a Debian in a virtual machine (needs ../shared)
	tests/vm/deployed.sh

install: ## install programs, services, rules and a first cell.toml (as root; PREFIX=, DESTDIR=; after make build)
	deploy/install.sh

uninstall: ## take away what install has put there; cell and records stay (as root; the same PREFIX=, DESTDIR=)
	deploy/uninstall.sh

fmt: ## format the sources
	$(CARGO) fmt --all

lint: needs licences ## formatting, clippy and licences
	$(CARGO) fmt --all -- --check
	$(CARGO) clippy --release --locked --workspace --all-targets -- -D warnings

doc: needs ## the documentation, in target/doc
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --release --locked --workspace --no-deps

licences: ## look at the licences of all dependencies (deny.toml)
	@scripts/licences.py
