//! From a message's bytes to rows of columns.
//!
//! Three things meet here and know nothing of one another: [`RECIPES`] say which fields of a type
//! fill which slot of a [`Row`]; a [`Plan`] reads those fields from the wire, by the schema in the
//! log; a [`Builder`] appends rows to the columns. A new message type is a recipe, a new encoding is
//! another way to fill a `Row`.

mod builder;
mod cdr;
mod plan;
mod row;
mod schema;
#[cfg(test)]
mod tests;

use self::row::Slot;

pub(super) use self::builder::Builder;
pub(super) use self::plan::Plan;
pub(super) use self::row::{Row, RowTimes};
pub(super) use self::schema::canonical;

/// How a message type becomes rows.
pub(super) struct Recipe {
    /// Type name as `package/Type`.
    type_name: &'static str,
    /// The array whose elements are a row each; without one, a message is a row.
    each: Option<&'static str>,
    /// Which field fills which slot, by its path from the message's root. All of them must exist.
    fields: &'static [(&'static str, Slot)],
    /// The columns to fill.
    pub(super) builder: fn() -> Builder,
}

/// How a log describes the messages of a channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Format<'a> {
    /// Encoding of the messages, such as `cdr`.
    pub(super) encoding: &'a str,
    /// Type name as the log spells it.
    pub(super) type_name: &'a str,
    /// Encoding of the schema, such as `ros2msg`; empty without a schema.
    pub(super) schema_encoding: &'a str,
    /// The schema.
    pub(super) schema: &'a [u8],
}

/// Why the messages of a channel cannot be decoded, whatever is in them.
#[derive(Debug, thiserror::Error)]
pub(super) enum FormatError {
    /// The messages are in an encoding that is not read here.
    #[error("messages are encoded as `{found}`, expected `cdr`")]
    Encoding { found: String },
    /// The schema is in a language that is not read here.
    #[error("schema is written in `{found}`, expected `ros2msg`")]
    SchemaEncoding { found: String },
    /// There is no schema to decode by.
    #[error("the log holds no schema for `{type_name}`")]
    NoSchema { type_name: String },
    /// The schema is broken, or lacks a field that is wanted.
    #[error("schema of `{type_name}`: {source}")]
    Schema { type_name: String, source: schema::SchemaError },
}

impl Recipe {
    /// The recipe for a type, which may be spelled `package/Type` or `package/msg/Type`.
    pub(super) fn of(type_name: &str) -> Option<&'static Recipe> {
        let type_name = schema::canonical(type_name);
        RECIPES.iter().find(|recipe| recipe.type_name == type_name)
    }

    /// How to read this recipe's fields from messages in `format`.
    pub(super) fn plan(&self, format: Format<'_>) -> Result<Plan, FormatError> {
        if format.encoding != "cdr" {
            return Err(FormatError::Encoding { found: format.encoding.to_owned() });
        }
        if format.schema.is_empty() {
            return Err(FormatError::NoSchema { type_name: format.type_name.to_owned() });
        }
        if format.schema_encoding != "ros2msg" {
            return Err(FormatError::SchemaEncoding { found: format.schema_encoding.to_owned() });
        }
        schema::Schema::parse(format.type_name, format.schema)
            .and_then(|schema| Plan::compile(&schema, self))
            .map_err(|source| FormatError::Schema {
                type_name: format.type_name.to_owned(),
                source,
            })
    }
}

/// Slots of a position and a quaternion in two nested messages.
macro_rules! pose_slots {
    ($position:literal, $orientation:literal, $($other:expr),*) => {
        &[
            $($other,)*
            (concat!($position, ".x"), Slot::Number(row::POSITION)),
            (concat!($position, ".y"), Slot::Number(row::POSITION + 1)),
            (concat!($position, ".z"), Slot::Number(row::POSITION + 2)),
            (concat!($orientation, ".x"), Slot::Number(row::QUATERNION)),
            (concat!($orientation, ".y"), Slot::Number(row::QUATERNION + 1)),
            (concat!($orientation, ".z"), Slot::Number(row::QUATERNION + 2)),
            (concat!($orientation, ".w"), Slot::Number(row::QUATERNION + 3)),
        ]
    };
}

/// Slots of the three components of a vector.
macro_rules! vector_slots {
    ($vector:literal, $first:expr) => {
        [
            (concat!($vector, ".x"), Slot::Number($first)),
            (concat!($vector, ".y"), Slot::Number($first + 1)),
            (concat!($vector, ".z"), Slot::Number($first + 2)),
        ]
    };
}
const GYRO: [(&str, Slot); 3] = vector_slots!("angular_velocity", row::GYRO);
const ACCEL: [(&str, Slot); 3] = vector_slots!("linear_acceleration", row::ACCEL);

/// Every message type that has columns.
static RECIPES: &[Recipe] = &[
    Recipe {
        type_name: "sensor_msgs/JointState",
        each: None,
        fields: &[
            ("header.stamp", Slot::Stamp),
            ("header.frame_id", Slot::Text(row::FRAME)),
            ("name", Slot::Names),
            ("position", Slot::List(row::VALUES)),
            ("velocity", Slot::List(row::VELOCITIES)),
        ],
        builder: Builder::joints,
    },
    Recipe {
        type_name: "geometry_msgs/PoseStamped",
        each: None,
        fields: pose_slots!(
            "pose.position",
            "pose.orientation",
            ("header.stamp", Slot::Stamp),
            ("header.frame_id", Slot::Text(row::FRAME))
        ),
        builder: Builder::poses,
    },
    Recipe {
        type_name: "geometry_msgs/PoseWithCovarianceStamped",
        each: None,
        fields: pose_slots!(
            "pose.pose.position",
            "pose.pose.orientation",
            ("header.stamp", Slot::Stamp),
            ("header.frame_id", Slot::Text(row::FRAME))
        ),
        builder: Builder::poses,
    },
    Recipe {
        type_name: "nav_msgs/Odometry",
        each: None,
        fields: pose_slots!(
            "pose.pose.position",
            "pose.pose.orientation",
            ("header.stamp", Slot::Stamp),
            ("header.frame_id", Slot::Text(row::FRAME)),
            ("child_frame_id", Slot::Text(row::CHILD))
        ),
        builder: Builder::poses,
    },
    Recipe {
        type_name: "geometry_msgs/TransformStamped",
        each: None,
        fields: pose_slots!(
            "transform.translation",
            "transform.rotation",
            ("header.stamp", Slot::Stamp),
            ("header.frame_id", Slot::Text(row::FRAME)),
            ("child_frame_id", Slot::Text(row::CHILD))
        ),
        builder: Builder::poses,
    },
    Recipe {
        type_name: "tf2_msgs/TFMessage",
        each: Some("transforms"),
        fields: pose_slots!(
            "transforms.transform.translation",
            "transforms.transform.rotation",
            ("transforms.header.stamp", Slot::Stamp),
            ("transforms.header.frame_id", Slot::Text(row::FRAME)),
            ("transforms.child_frame_id", Slot::Text(row::CHILD))
        ),
        builder: Builder::transforms,
    },
    Recipe {
        type_name: "sensor_msgs/Imu",
        each: None,
        fields: &[
            ("header.stamp", Slot::Stamp),
            ("header.frame_id", Slot::Text(row::FRAME)),
            ("orientation.x", Slot::Number(row::QUATERNION)),
            ("orientation.y", Slot::Number(row::QUATERNION + 1)),
            ("orientation.z", Slot::Number(row::QUATERNION + 2)),
            ("orientation.w", Slot::Number(row::QUATERNION + 3)),
            ("orientation_covariance", Slot::List(row::VALUES)),
            GYRO[0],
            GYRO[1],
            GYRO[2],
            ACCEL[0],
            ACCEL[1],
            ACCEL[2],
        ],
        builder: Builder::imu,
    },
    Recipe {
        type_name: "std_msgs/Float64MultiArray",
        each: None,
        fields: &[("data", Slot::List(row::VALUES))],
        builder: Builder::array,
    },
    Recipe {
        type_name: "std_msgs/String",
        each: None,
        fields: &[("data", Slot::Text(row::BODY))],
        builder: Builder::text,
    },
];
