# make demo  — everything from nothing: clips, training, export, inference, table and pictures
# make test  — lint and tests
# make bench — what is timed, against what (see benchmarks/)
PYTHON ?= python3
BIN := .venv/bin
DEMO := runs/demo
INSTALLED := .venv/.installed

.PHONY: demo test test-fast lint clean

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[train,fast,video,dev]"
	touch $@

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

test: lint
	$(BIN)/pytest

test-fast: $(INSTALLED)
	$(BIN)/pytest -m "not slow"

demo: $(INSTALLED)
	$(BIN)/python -m data.synthetic --output $(DEMO)/clips --clips 4 --frames 32 --seed 1
	$(BIN)/python train.py fit -c configs/smoke.yaml
	$(BIN)/python train.py test -c configs/smoke.yaml --ckpt_path $(DEMO)/training/checkpoints/best.ckpt
	$(BIN)/python train.py export -c configs/smoke.yaml --ckpt_path $(DEMO)/training/checkpoints/best.ckpt \
		--output $(DEMO)/parameters.onnx
	$(BIN)/python infer.py $(DEMO)/clips/video04 --model $(DEMO)/parameters.onnx --output $(DEMO)/results

clean:
	rm -rf .venv runs build *.egg-info
