//! A small regression tree. It is stored inline, so scoring a pair allocates no memory.

/// Largest number of levels of splits.
pub const MAX_DEPTH: usize = 3;

/// A node: to the left child if F < threshold, else to the right child.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Index of the feature.
    pub feature: usize,
    /// theta. It is infinite for a node that sends every pair to the left.
    pub threshold: f64,
}

impl Node {
    /// A node that sends every pair to the left.
    pub const PASS: Self = Self { feature: 0, threshold: f64::INFINITY };

    /// Whether the node can send a pair to the right.
    pub fn is_split(&self) -> bool {
        self.threshold.to_bits() != f64::INFINITY.to_bits()
    }
}

/// A complete binary tree with 1 to [`MAX_DEPTH`] levels of nodes, and leaves below them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tree {
    depth: usize,
    /// The nodes, level by level; the children of node k are nodes 2 k + 1 and 2 k + 2. Only the
    /// first 2^depth - 1 are used.
    nodes: [Node; (1 << MAX_DEPTH) - 1],
    /// The leaves from left to right. Only the first 2^depth are used.
    leaves: [f64; 1 << MAX_DEPTH],
}

impl Tree {
    /// Creates a tree from 2^depth - 1 nodes, level by level, and 2^depth leaves, from left to right.
    /// Returns `None` if the numbers of nodes and leaves do not match or if the depth is not 1 to
    /// [`MAX_DEPTH`].
    pub fn new(nodes: &[Node], leaves: &[f64]) -> Option<Self> {
        let depth = (1..=MAX_DEPTH).find(|depth| leaves.len() == 1 << depth)?;
        if nodes.len() + 1 != leaves.len() {
            return None;
        }
        let mut tree = Self {
            depth,
            nodes: [Node::PASS; (1 << MAX_DEPTH) - 1],
            leaves: [0.0; 1 << MAX_DEPTH],
        };
        tree.nodes[..nodes.len()].copy_from_slice(nodes);
        tree.leaves[..leaves.len()].copy_from_slice(leaves);
        Some(tree)
    }

    /// Number of levels of splits.
    pub fn depth(&self) -> usize {
        self.depth
    }

    /// The nodes, level by level, `(2^depth - 1,)`.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes[..(1 << self.depth) - 1]
    }

    /// The leaves from left to right, `(2^depth,)`.
    pub fn leaves(&self) -> &[f64] {
        &self.leaves[..1 << self.depth]
    }

    /// The same tree with `depth` levels, if it has fewer. The added nodes send every pair to the
    /// left.
    #[cfg(feature = "onnx")]
    pub(crate) fn deepened(&self, depth: usize) -> Self {
        let mut tree = *self;
        while tree.depth < depth {
            let n_leaves = tree.leaves().len();
            for leaf in (0..n_leaves).rev() {
                tree.leaves[2 * leaf] = tree.leaves[leaf];
                tree.leaves[2 * leaf + 1] = tree.leaves[leaf];
            }
            tree.nodes[n_leaves - 1..2 * n_leaves - 1].fill(Node::PASS);
            tree.depth += 1;
        }
        tree
    }

    /// The value of the leaf that a pair reaches. `difference` returns the difference of a feature.
    #[inline]
    pub fn value_of(&self, difference: impl Fn(usize) -> f64) -> f64 {
        let mut k = 0;
        for _ in 0..self.depth {
            let node = &self.nodes[k];
            k = 2 * k + 1 + usize::from(node.threshold <= difference(node.feature));
        }
        self.leaves[k + 1 - (1 << self.depth)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pair_reaches_its_leaf() {
        let node = |feature, threshold| Node { feature, threshold };
        let nodes = [node(0, 1.0), node(1, 5.0), node(1, 7.0)];
        let tree = Tree::new(&nodes, &[1.0, 2.0, 3.0, 4.0]).unwrap();
        let values =
            [[0.5, 4.0], [0.5, 5.0], [1.0, 6.0], [1.0, 7.0]].map(|f| tree.value_of(|k| f[k]));
        assert_eq!(values, [1.0, 2.0, 3.0, 4.0]);
        let tree = Tree::new(&[nodes[0], Node::PASS, nodes[2]], &[1.0, 2.0, 3.0, 4.0]).unwrap();
        assert_eq!(
            tree.value_of(|k| [0.5, 1e300][k]),
            1.0,
            "a node that does not split sends every pair to the left"
        );
        assert_eq!(Tree::new(&nodes[..1], &[1.0, 2.0]).unwrap().value_of(|_| 1.0), 2.0);
        assert_eq!(Tree::new(&nodes, &[1.0; 2]), None);
        assert_eq!(Tree::new(&[nodes[0]; 15], &[1.0; 16]), None);
    }
}
