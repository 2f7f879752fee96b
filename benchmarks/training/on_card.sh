#!/usr/bin/env bash
# A quarter of an hour on a machine with an NVIDIA card: the kernels are checked, the qualities timed, and the network of
# `high` trained. What comes back lies in OUT: tests.txt, devices.json, refinement.pt, refinement.npz and curve.json.
#
#     pip install -e '.[dev,train]' and a PyTorch for CUDA; then, in a clone:
#     benchmarks/training/on_card.sh FRAMES OUT [MINUTES]
#
# FRAMES is a folder that benchmarks/training/refinement_frames.py has filled. A checkpoint in OUT is gone on with.
set -euo pipefail
cd "$(dirname "$0")/../.."
frames="$1" out="$2" minutes="${3:-10}"
mkdir -p "$out"
python -m benchmarks.performance.devices -o "$out/devices.json"
python -m benchmarks.training.refinement --frames "$frames" --device cuda --batch 32 --rate 3e-4 \
  --start src/lobewise/denoising/refinement.npz --checkpoint "$out/refinement.pt" --curve "$out/curve.json" \
  --minutes "$minutes" --export "$out/refinement.npz"
# Tests come last, so that one that fails does not cost the training.
LOBEWISE_TEST_DEVICE=cuda python -m pytest -q -m "" tests/filters | tee "$out/tests.txt"
