/* How the compiler has laid out what Python fills in, and what the numbers are called: from this Python makes its
 * structures when it loads the library. */
#include <stddef.h>

#include "integrator.h"
#include "log.h"
#include "plan.h"

typedef struct {
  const char *structure, *field; /* without a field: the whole, whose fields come before it */
  const char *type;              /* as Python's ctypes calls it, or a structure that comes before */
  size_t offset, size;
} Place;

/* clang-format off */
#define TYPE(x) _Generic((x), double: "c_double", int32_t: "c_int32", int64_t: "c_int64", size_t: "c_size_t", \
                              char *: "c_char", default: "c_void_p")
/* clang-format on */
#define MEMBER(type, field) (((type *)0)->field)
#define WHOLE(type) {#type, NULL, NULL, 0, sizeof(type)},
#define PART(type, field, part) {#type, #field, part, offsetof(type, field), sizeof(MEMBER(type, field))},
#define FIELD(type, field) PART(type, field, TYPE(MEMBER(type, field)))

#define OF_2(name, takes) FIELD(Fmi2, name)
#define OF_3(name, takes) FIELD(Fmi3, name)
#define SET_OF_3(name, type, wire) FIELD(Fmi3, Set##name)
#define GET_OF_3(name, type, wire) FIELD(Fmi3, Get##name)
#define OF_SUNDIALS(gives, name, takes) FIELD(Sundials, name)

/* clang-format off */
static const Place places[] = {
    FMI2_FUNCTIONS(OF_2) WHOLE(Fmi2)
    FMI3_TYPES(SET_OF_3) SET_OF_3(String, , ) FMI3_TYPES(GET_OF_3) FMI3_FUNCTIONS(OF_3) WHOLE(Fmi3)
    FIELD(Report, failure) FIELD(Report, component) FIELD(Report, status) FIELD(Report, sample) FIELD(Report, state)
    FIELD(Report, time) FIELD(Report, step) WHOLE(Report)
    FIELD(Component, instance) FIELD(Component, fmi2) FIELD(Component, fmi3) FIELD(Component, integrator)
    FIELD(Component, tolerance) FIELD(Component, used) FIELD(Component, event_mode) FIELD(Component, mode)
    FIELD(Component, time) FIELD(Component, begun) WHOLE(Component)
    FIELD(Operation, kind) FIELD(Operation, function) FIELD(Operation, component) FIELD(Operation, wire)
    FIELD(Operation, when) FIELD(Operation, count) FIELD(Operation, references) FIELD(Operation, signal)
    FIELD(Operation, n_values) FIELD(Operation, values) FIELD(Operation, last) FIELD(Operation, instance)
    FIELD(Operation, fmi2) FIELD(Operation, source) FIELD(Operation, factor) FIELD(Operation, offset)
    WHOLE(Operation)
    FIELD(Range, first) FIELD(Range, last) WHOLE(Range)
    PART(Loop, get, "Range") PART(Loop, set, "Range") FIELD(Loop, n) FIELD(Loop, signals) FIELD(Loop, nominals)
    FIELD(Loop, unknowns) FIELD(Loop, residual) FIELD(Loop, correction) FIELD(Loop, starts) FIELD(Loop, magnitudes)
    FIELD(Loop, matrix) FIELD(Loop, inverse) FIELD(Loop, inverted) WHOLE(Loop)
    PART(Group, range, "Range") FIELD(Group, loop) WHOLE(Group)
    FIELD(Plan, n_components) FIELD(Plan, n_signals) FIELD(Plan, n_parameters) FIELD(Plan, n_inputs)
    FIELD(Plan, n_outputs) FIELD(Plan, n_groups) FIELD(Plan, components) FIELD(Plan, operations)
    PART(Plan, start_values, "Range") PART(Plan, inputs, "Range") PART(Plan, exchange, "Range")
    PART(Plan, outputs, "Range") PART(Plan, slopes, "Range") FIELD(Plan, after_step) FIELD(Plan, groups)
    FIELD(Plan, signals) FIELD(Plan, start_signals) FIELD(Plan, parameter_signals) FIELD(Plan, input_signals)
    FIELD(Plan, slope_signals) FIELD(Plan, output_signals) FIELD(Plan, output_terms) FIELD(Plan, input_modes)
    FIELD(Plan, curves) FIELD(Plan, direct_inputs) FIELD(Plan, direct_outputs) FIELD(Plan, ones) FIELD(Plan, curved)
    FIELD(Plan, midpoints) FIELD(Plan, by_rows) WHOLE(Plan)
    FIELD(Grid, n_times) FIELD(Grid, n_states) FIELD(Grid, times) FIELD(Grid, inputs) FIELD(Grid, slopes) FIELD(Grid, substeps)
    FIELD(Grid, strides) FIELD(Grid, gain) FIELD(Grid, measured) WHOLE(Grid)
    SUNDIALS_FUNCTIONS(OF_SUNDIALS) WHOLE(Sundials)
    FIELD(Sensitivities, count) FIELD(Sensitivities, magnitudes) FIELD(Sensitivities, initial)
    FIELD(Sensitivities, steps) FIELD(Sensitivities, knowns) FIELD(Sensitivities, twins) WHOLE(Sensitivities)
    FIELD(Integration, instance) FIELD(Integration, fmi2) FIELD(Integration, fmi3) FIELD(Integration, n_states)
    FIELD(Integration, n_indicators) FIELD(Integration, n_inputs) FIELD(Integration, n_input_references)
    FIELD(Integration, input_references) FIELD(Integration, curves) FIELD(Integration, state_references)
    FIELD(Integration, derivative_references) FIELD(Integration, tolerance) FIELD(Integration, largest_step)
    FIELD(Integration, limit) FIELD(Integration, most_steps) FIELD(Integration, method) FIELD(Integration, straight)
    FIELD(Integration, follows) FIELD(Integration, sensitivities) FIELD(Integration, sundials) WHOLE(Integration)
    PART(Integrator, how, "Integration") FIELD(Integrator, origin) FIELD(Integrator, time)
    FIELD(Integrator, step_start) FIELD(Integrator, step_end) FIELD(Integrator, step_length)
    FIELD(Integrator, next_step) FIELD(Integrator, next_event) FIELD(Integrator, n_steps) FIELD(Integrator, n_events)
    PART(Integrator, report, "Report") FIELD(Integrator, cancel) WHOLE(Integrator)
    FIELD(Message, status) FIELD(Message, text) WHOLE(Message)
    FIELD(Log, count) PART(Log, messages, "Message") FIELD(Log, callbacks) WHOLE(Log)
    {NULL, NULL, NULL, 0, 0},
};
/* clang-format on */

EXPORT const Place *layout(void) { return places; }

EXPORT const char *version(void) { return FMUID_VERSION; }

#define QUOTED(name) #name,
static const char *const names[] = {WIRES(QUOTED) FAILURES(QUOTED) NULL};

/* The wires and the failures, in the order of their numbers. */
EXPORT const char *const *code_names(void) { return names; }
