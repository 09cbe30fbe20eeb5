/* Transfers of values: operations one after the other. Those of Reals of FMI 2.0 are inlined. */
#ifndef TRANSFER_H
#define TRANSFER_H

#include "simulation.h"

bool perform_other(Simulation *self, Operation *operation);

/* Perform operations; stop at the first that fails. */
INLINE bool perform(Simulation *self, Range range) {
  for (size_t i = range.first; i < range.last; i++) {
    Operation *o = &self->plan->operations[i];
    int32_t status = fmi2OK;
    if (o->kind == SET_REALS)
      status = o->fmi2->SetReal(o->instance, o->references, o->count, o->values);
    else if (o->kind == GET_REALS)
      status = o->fmi2->GetReal(o->instance, o->references, o->count, o->values);
    else if (o->kind == SET_SLOPES)
      status = o->fmi2->SetRealInputDerivatives(o->instance, o->references, o->count, self->plan->ones, o->values);
    else if (!perform_other(self, o))
      return false;
    if (!good(status)) return fail(self, (Failure)o->function, (size_t)o->component, status);
  }
  return true;
}

#endif
