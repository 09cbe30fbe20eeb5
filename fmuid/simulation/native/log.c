#include "log.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

/* The next free place in a log; NULL if there is none. An FMU may speak from threads of its own. */
static Message *next(Log *log) {
  if (!log || atomic_load(&log->count) >= MOST_MESSAGES) return NULL;
  const int place = atomic_fetch_add(&log->count, 1);
  return place < MOST_MESSAGES ? &log->messages[place] : NULL;
}

static void log_message(void *environment, const char *instance, int32_t status, const char *category,
                        const char *format, ...) {
  (void)instance, (void)category;
  Message *message = next(environment);
  if (!message || !format) return;
  message->status = status;
  va_list values;
  va_start(values, format);
  if (vsnprintf(message->text, LONGEST_TEXT, format, values) < 0) message->text[0] = '\0';
  va_end(values);
}

void log_message_3(void *environment, int32_t status, const char *category, const char *message) {
  log_message(environment, "", status, category, "%s", message ? message : "");
}

const Callbacks *log_open(Log *log) {
  log->callbacks = (Callbacks){log_message, calloc, free, NULL, log};
  return &log->callbacks;
}
