//! Graphs against a second implementation in long integers, nodes against their bytes, and each operation by hand.

use fixed_math::logic::{Evaluation, Graph, GraphError, NODE_BYTES, Node, NodeError, Source};
use proptest::prelude::*;

fn input(index: u8) -> Source {
    Source::input(index).unwrap()
}

fn node(index: u8) -> Source {
    Source::node(index).unwrap()
}

/// The values of one node over passes with a and b as inputs.
fn over<const P: usize>(of: Node, passes: [(i32, i32); P]) -> [i32; P] {
    let mut graph = Graph::<1>::new(2).unwrap();
    graph.set(0, of).unwrap();
    passes.map(|(a, b)| {
        graph.evaluate(&[a, b]);
        graph.value(0).unwrap()
    })
}

fn over_a<const P: usize>(of: Node, passes: [i32; P]) -> [i32; P] {
    over(of, passes.map(|a| (a, 0)))
}

#[test]
fn comparators_hold_over_their_hysteresis() {
    let above = Node::Above { a: input(0), threshold: 10, hysteresis: 3 };
    assert_eq!(over_a(above, [9, 10, 7, 6, 7, 9, 10]), [0, 1, 1, 0, 0, 0, 1]);
    let greater = Node::Greater { a: input(0), b: input(1), hysteresis: 2 };
    assert_eq!(over(greater, [(4, 5), (5, 5), (5, 7), (5, 8), (6, 8), (8, 8)]), [0, 1, 1, 0, 0, 1]);
    // a threshold that the hysteresis takes past the end of the range is never left
    let lowest = Node::Above { a: input(0), threshold: i32::MIN, hysteresis: i32::MAX };
    assert_eq!(over_a(lowest, [i32::MIN, i32::MAX, i32::MIN]), [1, 1, 1]);
}

#[test]
fn windows_have_their_ends() {
    let inside = Node::Inside { a: input(0), low: -2, high: 5 };
    assert_eq!(over_a(inside, [-3, -2, 0, 5, 6]), [0, 1, 1, 1, 0]);
    let outside = Node::Outside { a: input(0), low: -2, high: 5 };
    assert_eq!(over_a(outside, [-3, -2, 0, 5, 6]), [1, 0, 0, 0, 1]);
}

#[test]
fn gates_and_truths() {
    let gate = Node::Gate { a: input(0), open: input(1), otherwise: -9 };
    assert_eq!(over(gate, [(7, 0), (7, 1), (8, -1), (8, 0)]), [-9, 7, 8, -9]);
    let all = [(0, 0), (0, 5), (-3, 0), (2, -1)];
    assert_eq!(over(Node::And { a: input(0), b: input(1) }, all), [0, 0, 0, 1]);
    assert_eq!(over(Node::Or { a: input(0), b: input(1) }, all), [0, 1, 1, 1]);
    assert_eq!(over(Node::ExclusiveOr { a: input(0), b: input(1) }, all), [0, 1, 1, 0]);
    assert_eq!(over(Node::Not { a: input(0) }, all), [1, 1, 0, 0]);
}

/// One pass long each, and none at the first pass, when nothing is known of before.
#[test]
fn edges_last_one_pass() {
    let signal = [1, 1, 0, 0, 4, -4, 0];
    assert_eq!(over_a(Node::Rising { a: input(0) }, signal), [0, 0, 0, 0, 1, 0, 0]);
    assert_eq!(over_a(Node::Falling { a: input(0) }, signal), [0, 0, 1, 0, 0, 0, 1]);
    assert_eq!(over_a(Node::Edge { a: input(0) }, signal), [0, 0, 1, 0, 1, 0, 1]);
    // a node that is set again has forgotten
    let mut graph = Graph::<1>::new(1).unwrap();
    graph.set(0, Node::Falling { a: input(0) }).unwrap();
    graph.evaluate(&[1]);
    graph.set(0, Node::Falling { a: input(0) }).unwrap();
    graph.evaluate(&[0]);
    assert_eq!(graph.is_true(0), Some(false));
}

#[test]
fn what_overflows_ends_at_its_own_side_and_is_told() {
    let (low, high) = (i32::MIN, i32::MAX);
    let sum = Node::Sum { a: input(0), b: input(1) };
    assert_eq!(over(sum, [(high, 1), (low, -1), (high, low), (2, 3)]), [high, low, -1, 5]);
    let difference = Node::Difference { a: input(0), b: input(1) };
    assert_eq!(over(difference, [(high, -1), (low, 1), (0, low), (2, 3)]), [high, low, high, -1]);
    let product = Node::Product { a: input(0), b: input(1), shift: 0 };
    assert_eq!(over(product, [(high, 2), (low, 2), (low, low), (low, -1), (-7, 6)]), [high, low, high, high, -42]);
    let mut graph = Graph::<2>::new(2).unwrap();
    graph.set(0, sum).unwrap();
    graph.set(1, product).unwrap();
    assert_eq!(graph.evaluate(&[high, high]), Evaluation { saturated: 2 });
    assert_eq!(graph.evaluate(&[high, 1]), Evaluation { saturated: 1 });
    assert_eq!(graph.evaluate(&[high, 0]), Evaluation { saturated: 0 });
}

/// 2^−16 of fractions: one and a half times a third, and halves go up.
#[test]
fn products_of_fractions() {
    let product = Node::Product { a: input(0), b: input(1), shift: 16 };
    assert_eq!(over(product, [(98_304, 21_845), (1, 32_768), (-1, 32_768), (-3, 32_768)]), [32_768, 1, 0, -1]);
    let q31 = Node::Product { a: input(0), b: input(1), shift: 31 };
    assert_eq!(
        over(q31, [(i32::MIN, i32::MIN), (i32::MIN, i32::MAX), (1 << 30, 1 << 30)]),
        [i32::MAX, -i32::MAX, 1 << 29]
    );
}

#[test]
fn graphs_that_one_pass_does_not_settle_are_refused() {
    let mut graph = Graph::<3>::new(2).unwrap();
    let not = |a| Node::Not { a };
    assert_eq!(graph.set(3, not(input(0))), Err(GraphError::NoSuchNode { index: 3, nodes: 3 }));
    assert_eq!(graph.set(1, not(node(1))), Err(GraphError::NotEarlier { index: 1, source: 1 }));
    let later = Node::Gate { a: input(0), open: node(2), otherwise: 0 };
    assert_eq!(graph.set(1, later), Err(GraphError::NotEarlier { index: 1, source: 2 }));
    assert_eq!(graph.set(1, not(input(2))), Err(GraphError::NoSuchInput { input: 2, inputs: 2 }));
    assert_eq!(graph.set(1, not(node(0))), Ok(()));
    let refused = graph.set(0, Node::Inside { a: input(0), low: 2, high: 1 });
    assert_eq!(refused, Err(GraphError::Node(NodeError::EmptyWindow { low: 2, high: 1 })));
    // nothing has changed
    assert_eq!(graph.node(0), Some(Node::Constant { value: 0 }));
    assert_eq!(graph.node(3), None);
    assert_eq!(Graph::<1>::new(129).err(), Some(GraphError::TooLarge { inputs: 129, nodes: 1 }));
    assert_eq!(Graph::<129>::new(1).err(), Some(GraphError::TooLarge { inputs: 1, nodes: 129 }));
}

#[test]
fn bytes_that_are_no_node_are_refused() {
    let decode = |bytes: [u8; NODE_BYTES]| Node::decode(&bytes);
    let operation = |code| [code, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(decode(operation(16)), Err(NodeError::UnknownOperation { operation: 16 }));
    assert_eq!(
        decode([1, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255]),
        Err(NodeError::NegativeHysteresis { hysteresis: -1 })
    );
    assert_eq!(decode([8, 0, 0, 32, 0, 0, 0, 0, 0, 0, 0, 0]), Err(NodeError::ShiftTooLarge { shift: 32 }));
    assert_eq!(decode([3, 0, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0]), Err(NodeError::EmptyWindow { low: 2, high: 1 }));
    let unused = |byte, value| Err(NodeError::UnusedField { operation: 12, byte, value });
    assert_eq!(decode([12, 0, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0]), unused(2, 7));
    assert_eq!(decode([12, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0, 0]), unused(3, 7));
    assert_eq!(decode([12, 0, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0]), unused(4, 7));
    assert_eq!(decode([12, 0, 0, 0, 0, 0, 0, 0, 7, 0, 0, 0]), unused(8, 7));
    assert_eq!(
        decode([0, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
        Err(NodeError::UnusedField { operation: 0, byte: 1, value: 7 })
    );
    // a window of a node, as a message has it
    let window = decode([3, 0x85, 0, 0, 0xff, 0xff, 0xff, 0xff, 2, 1, 0, 0]);
    assert_eq!(window, Ok(Node::Inside { a: node(5), low: -1, high: 258 }));
}

/// Any operation with any operands; not all of them make sense.
fn bytes() -> impl Strategy<Value = [u8; NODE_BYTES]> {
    let sparse = prop_oneof![3 => Just(0u8), 1 => any::<u8>()];
    (0u8..18, proptest::array::uniform11(sparse)).prop_map(|(operation, rest)| {
        let mut bytes = [0; NODE_BYTES];
        bytes[0] = operation;
        bytes[1..].copy_from_slice(&rest);
        bytes
    })
}

/// A node of a graph with three inputs at `index`, by its fields.
fn any_node(index: u8) -> impl Strategy<Value = Node> {
    let source = (0..3 + index).prop_map(|at| if at < 3 { input(at) } else { node(at - 3) });
    let x = prop_oneof![-8i32..8, any::<i32>()];
    (0u8..16, source.clone(), source, 0u8..32, x.clone(), x).prop_map(|(operation, a, b, shift, x, y)| {
        let (low, high) = (x.min(y), x.max(y));
        let hysteresis = x.saturating_abs();
        match operation {
            0 => Node::Constant { value: x },
            1 => Node::Above { a, threshold: y, hysteresis },
            2 => Node::Greater { a, b, hysteresis },
            3 => Node::Inside { a, low, high },
            4 => Node::Outside { a, low, high },
            5 => Node::Gate { a, open: b, otherwise: x },
            6 => Node::Sum { a, b },
            7 => Node::Difference { a, b },
            8 => Node::Product { a, b, shift },
            9 => Node::And { a, b },
            10 => Node::Or { a, b },
            11 => Node::ExclusiveOr { a, b },
            12 => Node::Not { a },
            13 => Node::Rising { a },
            14 => Node::Falling { a },
            _ => Node::Edge { a },
        }
    })
}

const NODES: usize = 6;

fn nodes() -> impl Strategy<Value = [Node; NODES]> {
    (any_node(0), any_node(1), any_node(2), any_node(3), any_node(4), any_node(5)).prop_map(Into::into)
}

/// The second implementation: signals in 128 bits, with the signal and the comparator of the pass before kept apart.
#[derive(Default)]
struct Model {
    values: [i128; NODES],
    /// by node: whether its source was true, and whether it was itself
    before: Option<[(bool, bool); NODES]>,
}

impl Model {
    fn evaluate(&mut self, nodes: &[Node; NODES], inputs: [i32; 3]) -> u8 {
        let mut now = [(false, false); NODES];
        let mut saturated = 0;
        for (index, of) in nodes.iter().enumerate() {
            let read = |source: Source| match source.as_input() {
                Some(at) => i128::from(inputs[usize::from(at)]),
                None => self.values[usize::from(source.as_node().unwrap())],
            };
            let (was_source, was) =
                self.before.map_or((None, None), |before| (Some(before[index].0), Some(before[index].1)));
            let mut source = false;
            let held = |threshold: i128, hysteresis: i32| {
                if was == Some(true) { threshold - i128::from(hysteresis) } else { threshold }
            };
            let value = match *of {
                Node::Constant { value } => i128::from(value),
                Node::Above { a, threshold, hysteresis } => i128::from(read(a) >= held(threshold.into(), hysteresis)),
                Node::Greater { a, b, hysteresis } => i128::from(read(a) >= held(read(b), hysteresis)),
                Node::Inside { a, low, high } => i128::from(read(a) >= i128::from(low) && read(a) <= i128::from(high)),
                Node::Outside { a, low, high } => i128::from(read(a) < i128::from(low) || read(a) > i128::from(high)),
                Node::Gate { a, open, otherwise } => {
                    if read(open) == 0 {
                        otherwise.into()
                    } else {
                        read(a)
                    }
                }
                Node::Sum { a, b } => read(a) + read(b),
                Node::Difference { a, b } => read(a) - read(b),
                Node::Product { a, b, shift } => (2 * read(a) * read(b) + (1 << shift)).div_euclid(2 << shift),
                Node::And { a, b } => i128::from(read(a) * read(b) != 0),
                Node::Or { a, b } => i128::from(read(a) != 0 || read(b) != 0),
                Node::ExclusiveOr { a, b } => i128::from((read(a) == 0) != (read(b) == 0)),
                Node::Not { a } => i128::from(read(a) == 0),
                Node::Rising { a } => {
                    source = read(a) != 0;
                    i128::from(was_source == Some(false) && source)
                }
                Node::Falling { a } => {
                    source = read(a) != 0;
                    i128::from(was_source == Some(true) && !source)
                }
                Node::Edge { a } => {
                    source = read(a) != 0;
                    i128::from(was_source == Some(!source))
                }
            };
            let cut = value.clamp(i32::MIN.into(), i32::MAX.into());
            saturated += u8::from(cut != value);
            self.values[index] = cut;
            now[index] = (source, cut != 0);
        }
        self.before = Some(now);
        saturated
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    /// Any graph, pass by pass.
    #[test]
    fn graphs_do_what_the_second_implementation_does(
        nodes in nodes(),
        passes in proptest::collection::vec(proptest::array::uniform3(prop_oneof![-3i32..3, any::<i32>()]), 1..12),
    ) {
        let mut graph = Graph::<NODES>::new(3).unwrap();
        for (index, of) in nodes.iter().enumerate() {
            graph.set(index, *of).unwrap();
        }
        let mut model = Model::default();
        for inputs in passes {
            let saturated = model.evaluate(&nodes, inputs);
            prop_assert_eq!(graph.evaluate(&inputs), Evaluation { saturated });
            for index in 0..NODES {
                prop_assert_eq!(graph.value(index).map(i128::from), Some(model.values[index]), "node {} of {:?}", index, nodes);
                prop_assert_eq!(graph.is_true(index), Some(model.values[index] != 0));
            }
        }
    }

    /// Whatever decodes encodes to the same bytes.
    #[test]
    fn bytes_come_back(bytes in bytes()) {
        if let Ok(node) = Node::decode(&bytes) {
            prop_assert_eq!(node.encode(), bytes);
        }
    }

    /// Whatever makes sense encodes to what decodes to it.
    #[test]
    fn nodes_come_back(node in any_node(4)) {
        prop_assert_eq!(Node::decode(&node.encode()), Ok(node));
    }
}
