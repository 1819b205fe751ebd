//! `flockslam config`: the configuration in force.

use super::{CommandError, print};
use crate::arguments::ConfigurationArgs;
use crate::configuration::Configuration;

/// Prints the configuration that the arguments lead to, as TOML.
///
/// # Errors
/// When the configuration is refused.
pub fn run(args: &ConfigurationArgs) -> Result<(), CommandError> {
    let configuration = Configuration::load(args.profile, args.config.as_deref(), &args.assignments)?;
    print(&toml::to_string(&configuration).map_err(CommandError::failed)?);
    Ok(())
}
