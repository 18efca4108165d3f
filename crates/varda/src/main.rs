//! The command line `varda`.

fn main() -> std::process::ExitCode {
    varda::cli::main()
}
