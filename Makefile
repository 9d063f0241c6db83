# Two commands on a fresh machine: `make demo` and `make test`. Everything lives in .venv.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test check docs soak peers results studies clean

.venv/run-ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	found=$$(for v in 11 12 13 14; do command -v python3.$$v; done | tr '\n' ' '); \
	echo "Python 3.11 or newer is needed; $(PYTHON) is $$($(PYTHON) -V 2>&1). On the path: $${found:-none}. Say make PYTHON=python3.11" >&2; \
	exit 1; }
	$(PYTHON) -m venv .venv
	$(PIP) -e '.[recon,live]'
	touch $@

.venv/test-ready: .venv/run-ready
	$(PIP) -e '.[recon,live,cluster,test]'
	$(PIP) --no-deps y-tal nptyping  # its own pins do not fit beside ours; only its file reader is used
	touch $@

demo: .venv/run-ready
	$(BIN)/nlos scan demo -o runs/demo.h5 --overwrite --reconstruct lct
	$(BIN)/nlos reconstruct runs/demo.h5 --method nano -o runs/demo-nano --overwrite
	$(BIN)/nlos report runs/demo.h5 -o runs/demo.html --overwrite
	rm -rf runs/live.h5 runs/live
	$(BIN)/nlos reconstruct runs/live.h5 --follow --method nano -o runs/live & follower=$$!; \
	$(BIN)/nlos scan anytime -o runs/live.h5 --until stable || { kill $$follower; exit 1; }; \
	wait $$follower
	$(BIN)/nlos report runs/live.h5 -o runs/live.html --overwrite

test: .venv/test-ready
	$(BIN)/python -m pytest -n 2 --dist loadfile

check: .venv/test-ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

.venv/docs-ready: .venv/run-ready
	$(PIP) -e '.[recon,live,docs]'
	touch $@

docs: .venv/docs-ready  # the site, in site/
	$(BIN)/python docs/make_settings.py
	$(BIN)/python docs/make_design.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

soak: .venv/test-ready
	NLOS_SOAK=1 $(BIN)/python -m pytest -m soak

peers: .venv/test-ready  # NLOS_PEERS=DIR holds other people's code; docs/peers.md
	$(BIN)/python -m pytest tests/peers -rs

results: .venv/run-ready  # docs/results.md; resumes from what is measured already
	$(BIN)/python -m studies.results ../shared/data docs

studies: .venv/run-ready  # docs/ablations.md; resumes; a second `make studies` beside it shares the work
	$(BIN)/python -m studies.ablations
	$(BIN)/python -m studies.without_noise
	$(BIN)/python -m studies.more_seeds

clean:
	rm -rf .venv build *.egg-info
