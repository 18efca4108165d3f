#!/usr/bin/env bash
# Builds the wheel into a virtual environment below the target folder and runs its tests there.
# Says "skipped: ..." and succeeds where Python, its venv or the packages from PyPI cannot be had.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
target=${CARGO_TARGET_DIR:-$here/../../target}
mkdir -p "$target"
target=$(cd "$target" && pwd)
export CARGO_TARGET_DIR=$target
environment=$target/python
cd "$here"

skip() {
    echo "skipped: the Python module: $1"
    exit 0
}

python=$(command -v python3 || true)
[ -n "$python" ] || skip "there is no python3"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 9))' || skip "$("$python" --version) is older than 3.9"
if [ ! -x "$environment/bin/pytest" ] || [ ! -x "$environment/bin/maturin" ]; then
    "$python" -m venv --clear "$environment" >/dev/null 2>&1 || skip "python3 -m venv fails"
    "$environment/bin/pip" install -q --disable-pip-version-check 'maturin>=1.9,<2' numpy pytest xarray scipy \
        >/dev/null 2>&1 || skip "pip cannot install maturin, numpy, pytest, xarray and scipy"
fi
# What the notebooks and models in JAX need; without it their tests are skipped and say so.
if [ ! -x "$environment/bin/jupytext" ]; then
    "$environment/bin/pip" install -q --disable-pip-version-check nbclient ipykernel jupytext matplotlib jax \
        >/dev/null 2>&1 || echo "skipped: the notebooks: pip cannot install nbclient, ipykernel, jupytext, matplotlib, jax"
fi

# A lock file that does not go with the crates above is a fault; a network that is not there is none.
if ! said=$(cargo fetch --locked --quiet 2>&1); then
    case $said in
        *"lock file"*) echo "error: crates/python/Cargo.lock is behind: cargo fetch in crates/python" >&2; exit 1 ;;
        *) skip "its crates cannot be fetched" ;;
    esac
fi

# The workspace above formats its own members only.
! cargo fmt --version >/dev/null 2>&1 || cargo fmt --check

# The profile that the tests of the workspace have built: only what depends on the interpreter is new.
"$environment/bin/maturin" build --quiet --profile dev --locked --interpreter "$environment/bin/python" \
    --out "$environment/wheels"
"$environment/bin/pip" install -q --disable-pip-version-check --force-reinstall --no-deps \
    "$(ls -t "$environment"/wheels/*.whl | head -n 1)"
[ ! -x "$target/debug/varda" ] || export VARDA_BINARY=$target/debug/varda
"$environment/bin/pytest" -q -rs -s -p no:cacheprovider tests
