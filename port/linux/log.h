/// Lines on standard error that never make their writer wait.
#ifndef CANOPY_PORT_LINUX_LOG_H
#define CANOPY_PORT_LINUX_LOG_H

/// Writes "name: text" as one line, cut to 400 characters, control characters replaced. From any thread. When standard
/// error cannot take it at once (nobody reads the pipe) the line is dropped, and the next one that gets through says
/// how many were.
void canopy_linux_log(const char *format, ...) __attribute__((format(printf, 1, 2)));

/// The name in front; "canopy" until this is called. It must live on.
void canopy_linux_log_name(const char *name);

#endif
