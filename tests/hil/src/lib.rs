//! Real images in emulators and, where one is attached, on boards.
#![forbid(unsafe_code)]
