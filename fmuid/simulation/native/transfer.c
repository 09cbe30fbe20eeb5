/* Transfers of values that are not just Reals of FMI 2.0: other types, conditions, copies, sensitivities. */ #include \
    "transfer.h"

#include <math.h>

#include "components.h"
#include "integrator.h"
#include "sensitivities.h"

/* ---- numbers of other types ---- */

/* What is stored as which type, and the largest double that it holds; the smallest is the next above `below`. */
#define WHOLE_TYPES(X)                                             \
  X(INT8, int8_t, -129.0, 128.0)                                   \
  X(UINT8, uint8_t, -1.0, 256.0)                                   \
  X(INT16, int16_t, -32769.0, 32768.0)                             \
  X(UINT16, uint16_t, -1.0, 65536.0)                               \
  X(INT32, int32_t, -2147483649.0, 2147483648.0)                   \
  X(UINT32, uint32_t, -1.0, 4294967296.0)                          \
  X(INT64, int64_t, -9223372036854777856.0, 9223372036854775808.0) \
  X(UINT64, uint64_t, -1.0, 18446744073709551616.0)

/* Store numbers as the type that a binary wants; whole ones are rounded. Return false if one does not fit. */
static bool pack(int32_t wire, const double *from, size_t n, void *to) {
  for (size_t j = 0; j < n; j++) {
    const double whole = nearbyint(from[j]);
    switch (wire) {
      case FLOAT32:
        ((float *)to)[j] = (float)from[j];
        break;
#define STORE(name, type, below, above)                  \
  case name:                                             \
    if (!(below < whole && whole < above)) return false; \
    ((type *)to)[j] = (type)whole;                       \
    break;
        WHOLE_TYPES(STORE)
      default:
        return false;
    }
  }
  return true;
}

/* Load numbers of the type that a binary gave. */
static void unpack(int32_t wire, const void *from, size_t n, double *to) {
  for (size_t j = 0; j < n; j++) {
    switch (wire) {
      case FLOAT32:
        to[j] = ((const float *)from)[j];
        break;
#define LOAD(name, type, below, above)       \
  case name:                                 \
    to[j] = (double)((const type *)from)[j]; \
    break;
        WHOLE_TYPES(LOAD)
      default:
        break;
    }
  }
}

/* ---- calls ---- */

static int32_t call2(const Fmi2 *fmi, const Operation *o) {
  switch (o->function) {
    case FLOAT64:
      return fmi->SetReal(o->instance, o->references, o->count, o->values);
    case INT32:
      return fmi->SetInteger(o->instance, o->references, o->count, o->values);
    case BOOLEAN:
      return fmi->SetBoolean(o->instance, o->references, o->count, o->values);
    case STRING:
      return fmi->SetString(o->instance, o->references, o->count, o->values);
    case N_WIRES + FLOAT64:
      return fmi->GetReal(o->instance, o->references, o->count, o->values);
    case N_WIRES + INT32:
      return fmi->GetInteger(o->instance, o->references, o->count, o->values);
    case N_WIRES + BOOLEAN:
      return fmi->GetBoolean(o->instance, o->references, o->count, o->values);
    default:
      return fmi2Fatal; /* Python lets no such operation through */
  }
}

static int32_t call3(const Fmi3 *fmi, const Operation *o) {
  switch (o->function) {
#define CALLS(name, type, wire)                                                          \
  case wire:                                                                             \
    return fmi->Set##name(o->instance, o->references, o->count, o->values, o->n_values); \
  case N_WIRES + wire:                                                                   \
    return fmi->Get##name(o->instance, o->references, o->count, o->values, o->n_values);
    FMI3_TYPES(CALLS)
    case STRING:
      return fmi->SetString(o->instance, o->references, o->count, o->values, o->n_values);
    default:
      return fmi2Fatal;
  }
}

/* ---- conditions ---- */

typedef enum { GO, SKIP, STOP } Verdict;

/* Note what is about to be set; return whether it differs from what was set before. */
static bool has_changed(const Plan *plan, const Operation *o) {
  bool changed = false;
  for (size_t j = 0; j < o->n_values; j++) {
    const double value = plan->signals[o->signal + j];
    changed = changed || value != o->last[j];
    o->last[j] = value;
  }
  return changed;
}

/* Say whether a value is to be set now, and take its component into the right mode. */
static Verdict before_setting(Simulation *self, const Operation *o) {
  const size_t c = (size_t)o->component;
  const Component *component = &self->plan->components[c];
  const int64_t *strides = self->grid->strides;
  if (o->when & LATCHED && strides && self->substep % strides[c] != 0) return SKIP;
  if (!(o->when & (AS_EVENT | AT_STEPS | WITH_RESTART))) return GO;
  const bool changed = has_changed(self->plan, o);
  if (component->mode != RUNNING) return GO;
  if (!changed) return o->when & AS_EVENT ? SKIP : GO;
  if (o->when & AS_EVENT || (o->when & AT_STEPS && self->stepped)) return enter_events(self, c) ? GO : STOP;
  if (o->when & WITH_RESTART && component->integrator) component->integrator->can_go_on = false;
  return GO;
}

/* Perform an operation that is not one of the usual ones. */
bool perform_other(Simulation *self, Operation *o) {
  const Plan *plan = self->plan;
  if (o->kind == COPY_ONE) {
    plan->signals[o->signal] = o->factor * plan->signals[o->source] + o->offset;
    return true;
  }
  const size_t c = (size_t)o->component;
  const Component *component = &plan->components[c];
  if (o->kind == GET_SENSITIVITIES) {
    return did(self, SENSITIVITIES, c, output_sensitivities(component->integrator, o->references, o->count, o->values));
  }
  if (o->when != ALWAYS) {
    const Verdict verdict = before_setting(self, o);
    if (verdict != GO) return verdict == SKIP;
  }
  const bool converted = o->wire != FLOAT64 && o->wire != STRING, sets = o->function < N_WIRES;
  double *signals = plan->signals + o->signal;
  if (converted && sets && !pack(o->wire, signals, o->n_values, o->values)) return fail(self, OUT_OF_RANGE, c, fmi2OK);
  const int32_t status = component->fmi2 ? call2(component->fmi2, o) : call3(component->fmi3, o);
  if (!did(self, (Failure)o->function, c, status)) return false;
  if (converted && !sets) unpack(o->wire, o->values, o->n_values, signals);
  return true;
}
