//! A layout for Foxglove.

use serde_json::{Map, Value, json};

use crate::overlay::{
    ACCEPTED, COVARIANCES, ODOMETRY, OPTIMIZED, REJECTED, SCAN_MATCHING, SUBMAPS, map_frame,
};

/// A layout file for Foxglove: a view of a map from above, with all topics of the overlay. Rejected closures
/// are hidden at first.
pub fn layout(map: u32) -> Value {
    let path = |color: &str| {
        json!({
            "visible": true,
            "type": "line",
            "lineWidth": 0.1,
            "gradient": [color, color],
        })
    };
    let topics = [
        (ACCEPTED, json!({ "visible": true })),
        (REJECTED, json!({ "visible": false })),
        (COVARIANCES, json!({ "visible": true })),
        (ODOMETRY, path("#ff8c00ff")),
        (SCAN_MATCHING, path("#b19cd9ff")),
        (OPTIMIZED, path("#1e90ffff")),
        (
            SUBMAPS,
            json!({
                "visible": true,
                "colorMode": "flat",
                "flatColor": "#a0a0a0ff",
                "pointSize": 2,
                // Longer than any drive \[s\]: the map grows while the log is played.
                "decayTime": 1e6,
            }),
        ),
    ];
    let topics: Map<String, Value> =
        topics.into_iter().map(|(topic, settings)| (topic.to_owned(), settings)).collect();
    json!({
        "configById": {
            "3D!loopboost": {
                "cameraState": {
                    "perspective": false,
                    "distance": 100,
                    "phi": 0,
                    "thetaOffset": 0,
                    "target": [0, 0, 0],
                    "targetOffset": [0, 0, 0],
                    "targetOrientation": [0, 0, 0, 1],
                    "fovy": 45,
                    "near": 0.5,
                    "far": 5000,
                },
                "followMode": "follow-none",
                "followTf": map_frame(map),
                "scene": { "transforms": { "showLabel": false } },
                "transforms": {},
                "topics": topics,
                "layers": {},
            },
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": { "speed": 1 },
        "layout": "3D!loopboost",
    })
}
