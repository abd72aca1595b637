//! Exports a model as ONNX, for use without loopboost.
//!
//! ```text
//! F (n, n_features) f64 ──Gather──► (n, n_rounds) ──Less, Where, or Mul, Add──► ──ReduceSum──► confidence (n,) f64
//!                         trees: a Gather and a Less for each node, then a Where for each node from the leaves up
//!                                                                      confidence >= threshold ──► label (n,) i64
//! ```
//!
//! The messages and field numbers are those of `onnx.proto` of ONNX 1.16 (IR version 8, operator set
//! 17). Only the messages and fields that are needed are defined here.

use prost::Message;

use crate::{Model, Tree, WeakLearner};

const IR_VERSION: i64 = 8;
const OPERATOR_SET: i64 = 17;
const INT64: i32 = 7;
const DOUBLE: i32 = 11;
const ATTRIBUTE_INT: i32 = 2;

#[derive(Clone, PartialEq, Message)]
struct ModelProto {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(string, tag = "2")]
    producer_name: String,
    #[prost(string, tag = "3")]
    producer_version: String,
    #[prost(string, tag = "6")]
    doc_string: String,
    #[prost(message, optional, tag = "7")]
    graph: Option<GraphProto>,
    #[prost(message, repeated, tag = "8")]
    opset_import: Vec<OperatorSetIdProto>,
    #[prost(message, repeated, tag = "14")]
    metadata_props: Vec<StringStringEntryProto>,
}

#[derive(Clone, PartialEq, Message)]
struct OperatorSetIdProto {
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

#[derive(Clone, PartialEq, Message)]
struct StringStringEntryProto {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(string, tag = "2")]
    value: String,
}

#[derive(Clone, PartialEq, Message)]
struct GraphProto {
    #[prost(message, repeated, tag = "1")]
    node: Vec<NodeProto>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    initializer: Vec<TensorProto>,
    #[prost(message, repeated, tag = "11")]
    input: Vec<ValueInfoProto>,
    #[prost(message, repeated, tag = "12")]
    output: Vec<ValueInfoProto>,
}

#[derive(Clone, PartialEq, Message)]
struct NodeProto {
    #[prost(string, repeated, tag = "1")]
    input: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    output: Vec<String>,
    #[prost(string, tag = "3")]
    name: String,
    #[prost(string, tag = "4")]
    op_type: String,
    #[prost(message, repeated, tag = "5")]
    attribute: Vec<AttributeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct AttributeProto {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(int64, tag = "3")]
    i: i64,
    #[prost(int32, tag = "20")]
    kind: i32,
}

#[derive(Clone, PartialEq, Message)]
struct TensorProto {
    #[prost(int64, repeated, tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(int64, repeated, tag = "7")]
    int64_data: Vec<i64>,
    #[prost(string, tag = "8")]
    name: String,
    #[prost(double, repeated, tag = "10")]
    double_data: Vec<f64>,
}

#[derive(Clone, PartialEq, Message)]
struct ValueInfoProto {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    kind: Option<TypeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TypeProto {
    #[prost(message, optional, tag = "1")]
    tensor_type: Option<TensorTypeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorTypeProto {
    #[prost(int32, tag = "1")]
    elem_type: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<TensorShapeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorShapeProto {
    #[prost(message, repeated, tag = "1")]
    dim: Vec<DimensionProto>,
}

/// A dimension: either a size or the name of a size.
#[derive(Clone, PartialEq, Message)]
struct DimensionProto {
    #[prost(int64, optional, tag = "1")]
    dim_value: Option<i64>,
    #[prost(string, optional, tag = "2")]
    dim_param: Option<String>,
}

/// The model as ONNX, serialised.
///
/// The input `F`, f64 `(n, n_features)`, contains the absolute feature differences `|f_a - f_b|` of n
/// pairs. The outputs are `confidence`, f64 `(n,)`, and `label`, i64 `(n,)`. The label is 1 if the
/// confidence is at least `threshold`, else -1.
pub fn to_onnx(model: &Model, threshold: f64) -> Vec<u8> {
    let rounds = &model.classifier.rounds;
    let each = |of: fn(&WeakLearner) -> f64| rounds.iter().map(of).collect::<Vec<f64>>();
    let mut graph = Graph::default();
    let trees: Vec<&Tree> = rounds.iter().filter_map(tree).collect();
    if trees.is_empty() {
        let features = rounds.iter().flat_map(WeakLearner::splits).map(|s| s.feature as i64);
        graph.integers("features", vec![rounds.len() as i64], features.collect());
        graph.node("Gather", &["F", "features"], "chosen", Some(("axis", 1)));
    }
    // All rounds of a classifier are of one kind.
    match rounds.first() {
        Some(WeakLearner::Tree(_)) => graph.trees(&trees),
        Some(WeakLearner::Line { .. }) | None => {
            graph.numbers("slopes", each(|weak| slope(weak).0));
            graph.numbers("intercepts", each(|weak| slope(weak).1));
            graph.node("Mul", &["chosen", "slopes"], "scaled", None);
            graph.node("Add", &["scaled", "intercepts"], "values", None);
        }
        Some(_) => {
            // The condition is `polarity F < polarity theta`. A step has polarity 1.
            graph.numbers("polarities", each(|weak| step(weak).0));
            graph.numbers("thresholds", each(|weak| step(weak).0 * step(weak).1));
            graph.numbers("if_below", each(|weak| step(weak).2));
            graph.numbers("if_not_below", each(|weak| step(weak).3));
            graph.node("Mul", &["chosen", "polarities"], "signed", None);
            graph.node("Less", &["signed", "thresholds"], "below", None);
            graph.node("Where", &["below", "if_below", "if_not_below"], "values", None);
        }
    }
    graph.integers("round_axis", vec![1], vec![1]);
    graph.node("ReduceSum", &["values", "round_axis"], "confidence", Some(("keepdims", 0)));
    graph.numbers("threshold", vec![threshold]);
    graph.integers("positive", vec![1], vec![1]);
    graph.integers("negative", vec![1], vec![-1]);
    graph.node("GreaterOrEqual", &["confidence", "threshold"], "is_positive", None);
    graph.node("Where", &["is_positive", "positive", "negative"], "label", None);

    let n_features =
        DimensionProto { dim_value: Some(model.features.names.len() as i64), dim_param: None };
    let pairs = || DimensionProto { dim_value: None, dim_param: Some("pairs".to_owned()) };
    let value = |name: &str, elem_type, dim| ValueInfoProto {
        name: name.to_owned(),
        kind: Some(TypeProto {
            tensor_type: Some(TensorTypeProto { elem_type, shape: Some(TensorShapeProto { dim }) }),
        }),
    };
    let property = |key: &str, value: String| StringStringEntryProto { key: key.to_owned(), value };
    let proto = ModelProto {
        ir_version: IR_VERSION,
        producer_name: "loopboost".to_owned(),
        producer_version: model.program_version.clone(),
        doc_string: "confidence that two planar scans show one place, from the absolute differences F of their features".to_owned(),
        graph: Some(GraphProto {
            name: model.name.clone(),
            node: graph.nodes,
            initializer: graph.constants,
            input: vec![value("F", DOUBLE, vec![pairs(), n_features])],
            output: vec![
                value("confidence", DOUBLE, vec![pairs()]),
                value("label", INT64, vec![pairs()]),
            ],
        }),
        opset_import: vec![OperatorSetIdProto { domain: String::new(), version: OPERATOR_SET }],
        metadata_props: vec![
            property("name", model.name.clone()),
            property("version", model.version.to_string()),
            property("feature_set", format!("{} v{}", model.features.set, model.features.version)),
            property("features", model.features.names.join(",")),
            property("gate_m", model.features.gate_m.to_string()),
            property("threshold", threshold.to_string()),
        ],
    };
    proto.encode_to_vec()
}

/// Slope and intercept of a line; 0 for other weak learners.
fn slope(weak: &WeakLearner) -> (f64, f64) {
    match *weak {
        WeakLearner::Line { slope, intercept, .. } => (slope, intercept),
        _ => (0.0, 0.0),
    }
}

/// Polarity, threshold, value below the threshold, and value at or above it.
fn step(weak: &WeakLearner) -> (f64, f64, f64, f64) {
    match *weak {
        WeakLearner::Vote { threshold, polarity, alpha, .. } => {
            (polarity, threshold, alpha, -alpha)
        }
        WeakLearner::Step { threshold, below, above, .. } => (1.0, threshold, below, above),
        WeakLearner::Line { .. } | WeakLearner::Tree(_) => (1.0, 0.0, 0.0, 0.0),
    }
}

fn tree(weak: &WeakLearner) -> Option<&Tree> {
    match weak {
        WeakLearner::Tree(tree) => Some(tree),
        _ => None,
    }
}

#[derive(Default)]
struct Graph {
    nodes: Vec<NodeProto>,
    constants: Vec<TensorProto>,
}

impl Graph {
    /// Adds nodes that compute `values`, `(n, n_rounds)`: the leaf of each tree. All trees get the
    /// same depth. Node k is computed for all trees at once: `Where` selects the left child if the
    /// feature is below the threshold, else the right child.
    fn trees(&mut self, trees: &[&Tree]) {
        let depth = trees.iter().map(|tree| tree.depth()).max().unwrap_or(1);
        let n_nodes = (1 << depth) - 1;
        let deep: Vec<Tree> = trees.iter().map(|tree| tree.deepened(depth)).collect();
        for leaf in 0..=n_nodes {
            let values = deep.iter().map(|tree| tree.leaves()[leaf]).collect();
            self.numbers(&format!("value_{}", n_nodes + leaf), values);
        }
        for k in (0..n_nodes).rev() {
            let node = |tree: &Tree| tree.nodes()[k];
            let [feature, threshold, chosen, below, left, right] = [
                format!("feature_{k}"),
                format!("threshold_{k}"),
                format!("chosen_{k}"),
                format!("below_{k}"),
                format!("value_{}", 2 * k + 1),
                format!("value_{}", 2 * k + 2),
            ];
            let features = deep.iter().map(|tree| node(tree).feature as i64).collect();
            self.integers(&feature, vec![deep.len() as i64], features);
            self.numbers(&threshold, deep.iter().map(|tree| node(tree).threshold).collect());
            self.node("Gather", &["F", &feature], &chosen, Some(("axis", 1)));
            self.node("Less", &[&chosen, &threshold], &below, None);
            let value = if k == 0 { "values".to_owned() } else { format!("value_{k}") };
            self.node("Where", &[&below, &left, &right], &value, None);
        }
    }

    fn node(&mut self, op: &str, inputs: &[&str], output: &str, attribute: Option<(&str, i64)>) {
        self.nodes.push(NodeProto {
            input: inputs.iter().map(|&name| name.to_owned()).collect(),
            output: vec![output.to_owned()],
            name: format!("make_{output}"),
            op_type: op.to_owned(),
            attribute: attribute
                .map(|(name, i)| AttributeProto { name: name.to_owned(), i, kind: ATTRIBUTE_INT })
                .into_iter()
                .collect(),
        });
    }

    fn numbers(&mut self, name: &str, values: Vec<f64>) {
        self.constants.push(TensorProto {
            dims: vec![values.len() as i64],
            data_type: DOUBLE,
            name: name.to_owned(),
            double_data: values,
            ..TensorProto::default()
        });
    }

    fn integers(&mut self, name: &str, dims: Vec<i64>, values: Vec<i64>) {
        self.constants.push(TensorProto {
            dims,
            data_type: INT64,
            name: name.to_owned(),
            int64_data: values,
            ..TensorProto::default()
        });
    }
}
