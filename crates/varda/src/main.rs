//! The command line `varda`.

#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    varda::cli::main()
}
