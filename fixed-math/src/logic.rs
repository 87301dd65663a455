//! Logic of signals: comparators, windows, gates, sums, products and edges, as a small graph that a message can set.
//!
//! - **Walk:** the values of tracks at a beat → [`Graph::evaluate`], one pass → a pin, a trigger, another track's gain.
//! - **Invariants:** a node reads inputs and nodes before it, and nothing else, so one pass in order settles all of them. A node that
//!   does not is refused when it is set; what overflows saturates and is counted in what is returned.
//! - **Context:** evaluating is for a beat: O(N), on a Cortex-M0+ about 60 to 100 cycles a node and 210 a product, no division, no recursion.
//!
//! **Truth:** every signal is an `i32`; it is true where it is not 0. What compares, combines truths or finds edges gives 1 or 0.
//!
//! ```
//! use fixed_math::logic::{Graph, Node, Source};
//!
//! // laser power, let through while the velocity is in a window
//! let (power, velocity) = (Source::input(0).unwrap(), Source::input(1).unwrap());
//! let mut graph = Graph::<4>::new(2).unwrap();
//! graph.set(0, Node::Inside { a: velocity, low: 100, high: 200 }).unwrap();
//! graph.set(1, Node::Gate { a: power, open: Source::node(0).unwrap(), otherwise: 0 }).unwrap();
//! graph.evaluate(&[700, 150]);
//! assert_eq!(graph.value(1), Some(700));
//! graph.evaluate(&[700, 201]);
//! assert_eq!((graph.is_true(0), graph.value(1)), (Some(false), Some(0)));
//! ```

mod node;

pub use node::{NODE_BYTES, Node, NodeError, Source};

use crate::widening::product_signed;
use core::fmt;

/// Most nodes, and most inputs, that a [`Source`] can name.
pub const SOURCES_MAX: usize = 128;

/// Why a graph or a node of it was refused. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GraphError {
    /// The graph has no such node. Use a lower index.
    NoSuchNode {
        /// Where it was to go.
        index: usize,
        /// Nodes there are.
        nodes: usize,
    },
    /// A source is the node itself or one after it. Set it further down.
    NotEarlier {
        /// Where it was to go.
        index: usize,
        /// The node that it reads.
        source: u8,
    },
    /// A source is an input that the graph has not got. Use a lower one.
    NoSuchInput {
        /// The input that it reads.
        input: u8,
        /// Inputs there are.
        inputs: usize,
    },
    /// The node does not make sense in itself.
    Node(NodeError),
    /// More inputs or nodes than [`SOURCES_MAX`].
    TooLarge {
        /// Inputs asked for.
        inputs: usize,
        /// Nodes asked for.
        nodes: usize,
    },
}

impl fmt::Display for GraphError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoSuchNode { index, nodes } => {
                write!(f, "node {index} of a graph of {nodes}: use a lower index")
            }
            Self::NotEarlier { index, source } => {
                write!(f, "node {index} reads node {source}, which is evaluated no earlier: set it further down")
            }
            Self::NoSuchInput { input, inputs } => {
                write!(f, "input {input} of a graph of {inputs} inputs: use a lower one")
            }
            Self::Node(error) => error.fmt(f),
            Self::TooLarge { inputs, nodes } => {
                write!(f, "{inputs} inputs and {nodes} nodes, of which {SOURCES_MAX} each can be told apart: use fewer")
            }
        }
    }
}

impl core::error::Error for GraphError {}

impl From<NodeError> for GraphError {
    fn from(error: NodeError) -> Self {
        Self::Node(error)
    }
}

/// What one pass reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evaluation {
    /// Nodes whose value did not fit and was cut to the limit of its side.
    pub saturated: u8,
}

/// What a node knew at the last pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Before {
    /// It has not been evaluated since it was set.
    Nothing,
    False,
    True,
}

impl Before {
    const fn of(truth: bool) -> Self {
        if truth { Self::True } else { Self::False }
    }
}

/// N nodes, each a constant 0 until it is set.
#[derive(Clone, Debug)]
pub struct Graph<const N: usize> {
    nodes: [Node; N],
    values: [i32; N],
    before: [Before; N],
    inputs: usize,
}

impl<const N: usize> Graph<N> {
    /// A graph that reads `inputs` signals.
    ///
    /// # Errors
    ///
    /// [`GraphError::TooLarge`].
    pub const fn new(inputs: usize) -> Result<Self, GraphError> {
        if inputs > SOURCES_MAX || N > SOURCES_MAX {
            return Err(GraphError::TooLarge { inputs, nodes: N });
        }
        Ok(Self { nodes: [Node::Constant { value: 0 }; N], values: [0; N], before: [Before::Nothing; N], inputs })
    }

    /// Puts `node` at `index` and forgets what the one before it there knew.
    ///
    /// # Errors
    ///
    /// Any [`GraphError`] but `TooLarge`.
    pub fn set(&mut self, index: usize, node: Node) -> Result<(), GraphError> {
        if index >= N {
            return Err(GraphError::NoSuchNode { index, nodes: N });
        }
        node.check()?;
        for source in node.sources().into_iter().flatten() {
            match (source.as_input(), source.as_node()) {
                (Some(input), _) if usize::from(input) >= self.inputs => {
                    return Err(GraphError::NoSuchInput { input, inputs: self.inputs });
                }
                (_, Some(source)) if usize::from(source) >= index => {
                    return Err(GraphError::NotEarlier { index, source });
                }
                _ => {}
            }
        }
        self.nodes[index] = node;
        self.values[index] = 0;
        self.before[index] = Before::Nothing;
        Ok(())
    }

    /// The node at `index`.
    #[must_use]
    pub fn node(&self, index: usize) -> Option<Node> {
        self.nodes.get(index).copied()
    }

    /// What the node at `index` came to in the last pass; 0 before the first.
    #[must_use]
    #[inline]
    pub fn value(&self, index: usize) -> Option<i32> {
        self.values.get(index).copied()
    }

    /// Whether that is true: not 0.
    #[must_use]
    #[inline]
    pub fn is_true(&self, index: usize) -> Option<bool> {
        self.value(index).map(|value| value != 0)
    }

    /// One pass over all nodes, once a beat. An input that is missing from `inputs` reads 0.
    pub fn evaluate(&mut self, inputs: &[i32]) -> Evaluation {
        let mut report = Evaluation::default();
        for index in 0..N {
            let (value, truth, fits) = self.evaluate_node(index, inputs);
            self.values[index] = value;
            self.before[index] = Before::of(truth);
            report.saturated += u8::from(!fits);
        }
        report
    }

    fn read(&self, source: Source, inputs: &[i32]) -> i32 {
        let from: &[i32] = if source.as_input().is_some() { inputs } else { &self.values };
        from.get(source.index()).copied().unwrap_or(0)
    }

    /// The value, the truth to be remembered, and whether the value fits.
    fn evaluate_node(&self, index: usize, inputs: &[i32]) -> (i32, bool, bool) {
        let read = |source| self.read(source, inputs);
        let is_true = |source| read(source) != 0;
        let before = self.before[index];
        let truth = match self.nodes[index] {
            Node::Constant { value } => return (value, value != 0, true),
            Node::Gate { a, open, otherwise } => {
                let value = if is_true(open) { read(a) } else { otherwise };
                return (value, value != 0, true);
            }
            Node::Sum { a, b } => return saturated(read(a).checked_add(read(b)), read(a) < 0),
            Node::Difference { a, b } => return saturated(read(a).checked_sub(read(b)), read(a) < 0),
            Node::Product { a, b, shift } => {
                let (a, b) = (read(a), read(b));
                return saturated(scaled_product(a, b, shift), (a < 0) != (b < 0));
            }
            Node::Above { a, threshold, hysteresis } => compare(read(a), threshold, hysteresis, before),
            Node::Greater { a, b, hysteresis } => compare(read(a), read(b), hysteresis, before),
            Node::Inside { a, low, high } => (low..=high).contains(&read(a)),
            Node::Outside { a, low, high } => !(low..=high).contains(&read(a)),
            Node::And { a, b } => is_true(a) && is_true(b),
            Node::Or { a, b } => is_true(a) || is_true(b),
            Node::ExclusiveOr { a, b } => is_true(a) != is_true(b),
            Node::Not { a } => !is_true(a),
            Node::Rising { a } => return edge(before == Before::False, is_true(a), true),
            Node::Falling { a } => return edge(before == Before::True, is_true(a), false),
            Node::Edge { a } => {
                let now = is_true(a);
                return (i32::from(before != Before::Nothing && before != Before::of(now)), now, true);
            }
        };
        (i32::from(truth), truth, true)
    }
}

/// True from `threshold` on, until it is more than `hysteresis` below.
fn compare(value: i32, threshold: i32, hysteresis: i32, before: Before) -> bool {
    value >= if before == Before::True { threshold.saturating_sub(hysteresis) } else { threshold }
}

/// An edge to `wanted`; what is remembered is the signal, not the edge.
fn edge(was_other: bool, now: bool, wanted: bool) -> (i32, bool, bool) {
    (i32::from(was_other && now == wanted), now, true)
}

fn saturated(value: Option<i32>, is_negative: bool) -> (i32, bool, bool) {
    let limit = if is_negative { i32::MIN } else { i32::MAX };
    (value.unwrap_or(limit), value != Some(0), value.is_some())
}

/// `a · b / 2^shift` to the nearest, halves up; `None` where it does not fit.
#[inline]
fn scaled_product(a: i32, b: i32, shift: u8) -> Option<i32> {
    // 2^62 and a half of 2^31: no overflow
    let half = if shift == 0 { 0 } else { 1u32 << (shift - 1) };
    let product = product_signed(a, b) + i64::from(half);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the two halves, as shifts of 64 bits are slow where there is no instruction"
    )]
    let (high, low) = ((product >> 32) as i32, product as u32);
    let value = if shift == 0 { low } else { (high.cast_unsigned() << (32 - shift)) | (low >> shift) }.cast_signed();
    // what is above has to be its sign
    (high >> shift == value >> 31).then_some(value)
}
