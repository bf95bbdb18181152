# Everything below works in a fresh clone; each first makes .venv, or finds it made.
#   make demo PYTHON=/path/to/python3   chooses the Python (3.10 to 3.13)
#   make demo DEMO_ARGS='--out here'    hands arguments on; so do TEST_ARGS and BENCH_ARGS
export PYTHON

RUN := tools/run.sh

.PHONY: help setup setup-docs setup-test demo test coverage bench bench-blind lint docs workspace colcon lock clean

help:
	@echo 'make setup        .venv with ROS 2 Jazzy, our messages and this package'
	@echo 'make demo         from a recorded bag to identified parameters and a report in out/'
	@echo 'make test         the tests that a change must pass, in some five minutes on two cores'
	@echo 'make coverage     the same, and how much of the package it runs'
	@echo 'make bench        speed, loss and faults in minutes; BENCH_ARGS="--full NAME" for a campaign'
	@echo 'make bench-blind  300 fresh blind draws, and whether the promised rates are kept'
	@echo 'make lint         ruff and mypy'
	@echo 'make docs         the documentation as a site in docs/_build, warnings as errors'
	@echo 'make workspace WS=FOLDER   both packages side by side for rosdep and colcon'
	@echo 'make colcon       both packages built by colcon in a workspace of their own'
	@echo 'make lock         requirements/lock/ anew from requirements/*.in'
	@echo 'make clean        remove .venv, out/ and what builds leave'

setup:
	@tools/set_up.sh

setup-test:
	@tools/set_up.sh test

demo: setup
	@$(RUN) saddlering demo $(DEMO_ARGS)

test: setup-test
	@tools/test.sh $(TEST_ARGS)

coverage:
	@tools/set_up.sh coverage
	@$(RUN) python tools/measure_coverage.py $(TEST_ARGS)

bench: setup-test
	@$(RUN) python benchmarks/run.py $(BENCH_ARGS)

bench-blind: setup-test
	@$(RUN) python -m pytest --quiet -n 0 --campaigns -m campaign test/diagnosis
	@$(RUN) python benchmarks/blind.py $(BENCH_ARGS)

lint: setup-test
	@$(RUN) ruff check .
	@$(RUN) mypy saddlering_ros
	@cd benchmarks && ../$(RUN) mypy *.py

setup-docs:
	@tools/set_up.sh docs

docs: setup-docs
	@$(RUN) python -m sphinx --fail-on-warning --keep-going --quiet -b html docs docs/_build

workspace:
	@tools/workspace.sh "$(WS)"

colcon: setup
	@tools/colcon_build.sh

lock:
	@python3 tools/lock.py

clean:
	rm -rf .venv out docs/_build build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info
