/** A number, with what it is. */
export function Field(props: {
  label: string;
  value: string;
  /** What is taken where nothing is given. */
  hint?: number;
  least: number;
  most: number;
  /** Whole numbers only. */
  whole?: boolean;
  /** May be left empty. */
  free?: boolean;
  onChange: (value: string) => void;
}) {
  return (
    <label>
      {props.label}
      <input
        type="number"
        inputMode={props.whole ? "numeric" : "decimal"}
        required={!props.free}
        min={props.least}
        max={props.most}
        step={props.whole ? 1 : "any"}
        value={props.value}
        placeholder={props.hint === undefined ? "" : String(props.hint)}
        onInput={(event) => props.onChange(event.currentTarget.value)}
      />
    </label>
  );
}
