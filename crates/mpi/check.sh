#!/usr/bin/env bash
# Builds varda-mpi and runs its tests: mpirun with 1, 2 and 4 ranks beside the plain program.
# Says "skipped: ..." and succeeds where an MPI, libclang or the crates cannot be had.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
target=${CARGO_TARGET_DIR:-$here/../../target}
mkdir -p "$target"
target=$(cd "$target" && pwd)
export CARGO_TARGET_DIR=$target
cd "$here"

skip() {
    echo "skipped: the program for many hosts: $1"
    exit 0
}

# mpicc finds headers and libraries, libclang reads them.
have() {
    local library
    library=${LIBCLANG_PATH:-$(find /usr/lib /usr/lib64 /usr/local/lib \
        \( -name 'libclang.so*' -o -name 'libclang-[0-9]*.so*' \) -print -quit 2>/dev/null || true)}
    command -v mpicc >/dev/null && command -v mpirun >/dev/null && [ -n "$library" ]
}
if ! have && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update -qq && apt-get install -y -qq openmpi-bin libopenmpi-dev libclang-dev; } >/dev/null 2>&1 ||
        skip "openmpi-bin, libopenmpi-dev and libclang-dev cannot be installed"
fi
have || skip "there is no MPI (mpicc, mpirun), or no libclang"

# A lock file that does not go with the crates above is a fault; a network that is not there is none.
if ! said=$(cargo fetch --locked --quiet 2>&1); then
    case $said in
        *"lock file"*) echo "error: crates/mpi/Cargo.lock is behind: cargo fetch in crates/mpi" >&2; exit 1 ;;
        *) skip "its crates cannot be fetched" ;;
    esac
fi

# The workspace above formats and lints its own members only.
! cargo fmt --version >/dev/null 2>&1 || cargo fmt --check

[ ! -x "$target/debug/varda" ] || export VARDA_BINARY=$target/debug/varda
# One at a time: each starts as many processes as there are ranks.
cargo test --quiet --locked -- --test-threads=1
