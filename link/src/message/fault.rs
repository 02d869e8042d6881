//! Errors of the runtime on the wire: the same variants with numbers of fixed width, there and back.

/// What is sent in the place of something of the runtime, or the other way round.
pub(super) trait Sent<T> {
    fn sent(self) -> T;
}

impl Sent<u32> for usize {
    fn sent(self) -> u32 {
        super::failure::number(self)
    }
}

impl Sent<usize> for u32 {
    fn sent(self) -> usize {
        self as usize
    }
}

/// What is sent as it is.
macro_rules! sent_as_it_is {
    ($($number:ty),*) => {
        $(impl Sent<$number> for $number {
            fn sent(self) -> $number {
                self
            }
        })*
    };
}

sent_as_it_is!(u8, u16, f32);

/// An error of the runtime as it is sent: an enum with the variants and fields of that error, in the order that is the wire format. Its words
/// are the runtime's; they are printed on the host's side.
macro_rules! fault {
    (
        $(#[$about:meta])*
        $fault:ident of $error:ident {
            $($(#[$why:meta])* $variant:ident $({ $($(#[$what:meta])* $field:ident: $number:ty,)* })?,)*
        }
    ) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
        pub enum $fault {
            $($(#[$why])* $variant $({ $($(#[$what])* $field: $number,)* })?,)*
        }

        impl From<$error> for $fault {
            fn from(error: $error) -> Self {
                match error {
                    $($error::$variant $({ $($field,)* })? => {
                        Self::$variant $({ $($field: $crate::message::fault::Sent::sent($field),)* })?
                    })*
                }
            }
        }

        impl From<$fault> for $error {
            fn from(fault: $fault) -> Self {
                match fault {
                    $($fault::$variant $({ $($field,)* })? => {
                        Self::$variant $({ $($field: $crate::message::fault::Sent::sent($field),)* })?
                    })*
                }
            }
        }

        impl core::fmt::Display for $fault {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                $error::from(*self).fmt(f)
            }
        }

        impl core::error::Error for $fault {}
    };
}

pub(super) use fault;
