//! Scans of simulated networks, held against what the simulator built.

mod scan {
    mod shapes;
    mod support;
    mod troubles;
}
