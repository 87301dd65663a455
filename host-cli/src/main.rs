//! The command `osap`; all of it is in the library's `cli`, where tests can reach it.
#![forbid(unsafe_code)]

fn main() -> osap::cli::Exit {
    osap::cli::main()
}
